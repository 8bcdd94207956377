from ethernetip import EtherNetIP, KeyRing

# T->O data comes to port 2223, because the adapter has port 2222 of this computer.
enip = EtherNetIP("127.0.0.2")
connection = enip.explicit_conn("127.0.0.2")
bits_in = enip.registerAssembly(EtherNetIP.ENIP_IO_TYPE_INPUT, 12, 100, connection)
bits_out = enip.registerAssembly(EtherNetIP.ENIP_IO_TYPE_OUTPUT, 8, 150, connection)
assert connection.listID().product_name == b"WSG" and enip.listIDUDP("127.0.0.2", 60).product_name == b"WSG"
enip.startIO(2223)
connection.registerSession()
opening = dict(torpi=20, otrpi=20, inputsz=12, outputsz=8, multiplier=7, originator_udp_port=2223)
key = dict(devicetype=0x2B, productcode=1, version_major=1, version_minor=1)
assert connection.sendFwdOpenReq(100, 150, 151, keyring=KeyRing(**{**key, "productcode": 2}), **opening) == 0x0114
assert connection.sendFwdOpenReq(100, 150, 151, **{**opening, "inputsz": 11}) == 0x0128
assert connection.sendFwdOpenReq(100, 150, 151, keyring=KeyRing(**key), **opening) == 0
connection.produce()


def inputs():
    return bytes(sum(bits_in[8 * at + bit] << bit for bit in range(8)) for at in range(12))


def set_outputs(image):
    # Flags last, so that the parameters of a command are complete.
    for at in [*range(1, 8), 0]:
        for bit in range(8):
            bits_out[8 * at + bit] = bool(image[at] >> bit & 1)


run(inputs, set_outputs)
connection.stopProduce()
assert connection.sendFwdCloseReq(100, 150, 151) == 0
enip.stopIO()
print("cycle done")
