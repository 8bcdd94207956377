import struct
import time

from pycomm3 import CIPDriver

identity = CIPDriver.list_identity("127.0.0.2")
assert (identity["product_name"], identity["product_code"]) == ("WSG", 1), identity
assert (identity["revision"], identity["ip_address"]) == ({"major": 1, "minor": 1}, "127.0.0.2"), identity
with CIPDriver("127.0.0.2") as driver:
    for routing in (dict(connected=False, unconnected_send=False), dict(connected=False, unconnected_send=True), dict(connected=True)):

        def read(class_code, instance, attribute):
            answer = driver.generic_message(service=0x0E, class_code=class_code, instance=instance, attribute=attribute, **routing)
            assert answer.error is None, (routing, answer)
            return answer.value

        # A gateway may not have connected to its gripper yet.
        end = time.time() + 60
        while (inputs := read(4, 100, 3))[0] != 1:
            assert time.time() < end, inputs
        assert (len(inputs), read(4, 150, 3)) == (12, bytes(8)), inputs
        # The register map has the same words, as numbers of EtherNet/IP. pycomm3 cannot request attribute 0.
        words = [struct.unpack("<H", read(0x64, 4, at))[0] for at in range(1, 6)]
        assert struct.pack(">5H", *words) == inputs[2:], (words, inputs)
        refused = driver.generic_message(service=0x0E, class_code=0x64, instance=4, attribute=999, **routing)
        assert refused.error is not None, refused
        # No explicit message sets outputs.
        refused = driver.generic_message(service=0x10, class_code=4, instance=150, attribute=3, request_data=bytes(8), **routing)
        assert refused.error is not None, refused
print("passed")
