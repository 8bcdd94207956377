# `pnio-dcp` at the virtual gripper. Stubs replace the modules that only find its interface and version.
import sys
import types
from importlib import metadata


def module(name, **contents):
    sys.modules[name] = types.ModuleType(name)
    vars(sys.modules[name]).update(contents)


ADDRESS, INTERFACE = "192.168.7.1", "eth0"
with open(f"/sys/class/net/{INTERFACE}/address") as file:
    own = file.read().strip()
entry = lambda family, address: types.SimpleNamespace(family=family, address=address)
module("psutil", net_if_addrs=lambda: {INTERFACE: [entry(2, ADDRESS), entry(17, own)]}, AF_LINK=17)
module("setuptools_scm", get_version=lambda *_, **__: "0")
module("importlib_metadata", version=metadata.version, PackageNotFoundError=metadata.PackageNotFoundError)

import pnio_dcp

master = pnio_dcp.DCP(ADDRESS)
devices = master.identify_all(timeout=3)
assert len(devices) == 1, devices
mac = devices[0].MAC
assert devices[0].family == "WSG", devices[0].family
assert master.set_name_of_station(mac, "wsg-test")
assert master.get_name_of_station(mac) == "wsg-test"
assert master.set_ip_address(mac, ["192.168.7.5", "255.255.255.0", "192.168.7.1"])
assert master.get_ip_address(mac) == "192.168.7.5"
device = master.identify(mac)
assert (device.name_of_station, device.IP, device.netmask) == ("wsg-test", "192.168.7.5", "255.255.255.0")
assert not master.set_ip_address(mac, ["192.168.7.255", "255.255.255.0", "0.0.0.0"])
assert master.blink(mac)
assert master.reset_to_factory(mac)
assert master.get_name_of_station(mac) == "", master.get_name_of_station(mac)
assert master.set_name_of_station(mac, "wsg-test")
assert master.factory_reset(mac)
assert master.get_ip_address(mac) == "0.0.0.0"
