# canopen as a master that updates the bridge: program data and program control. Arguments: terminal of an SLCAN adapter, image in
# hexadecimal, EDS file.
import sys

import canopen

network = canopen.Network()
network.connect(interface="slcan", channel=sys.argv[1], bitrate=500_000, sleep_after_open=0)
node = network.add_node(0x10, sys.argv[3])
node.sdo.RESPONSE_TIMEOUT = 60
image = bytes.fromhex(sys.argv[2])
damaged = bytes([image[0] ^ 1]) + image[1:]


def download(file):
    with node.sdo["Program data"][1].open("wb", size=len(file)) as stream:
        stream.write(file)


try:
    download(damaged)
    assert False, "a damaged image is accepted"
except canopen.SdoAbortedError as abort:
    assert abort.code == 0x0800_0020, abort
download(image)
node.sdo["Program control"][1].raw = 1
print("passed")
