# Queries the endpoint mapper of the virtual gripper as engineering tools do, in both byte orders: the first entry, the
# missing second entry, and the end of the list. The messages follow the DCE specification, byte by byte.
import socket
import struct
import uuid

DEVICE = ("192.168.7.5", 34964)
EPM = uuid.UUID("e1af8308-5d1f-11c9-91a4-08002b14a0fa")
PNIO_DEVICE = uuid.UUID("dea00001-6c97-11d1-8271-00a02442df7d")
# Instance 1 of device 0001h of vendor 02A2h.
OBJECT = uuid.UUID("dea00000-6c97-11d1-8271-0001000102a2")
LOOKUP, FREE_HANDLE = 2, 4
RESPONSE = 2
NOT_REGISTERED = 0x16C9A0D6
INSTANT = 10


class Client:
    def __init__(self, order):
        self.order = order
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(INSTANT)
        self.activity = uuid.uuid4()
        self.sequence = 0

    def pack(self, layout, *values):
        return struct.pack(self.order + layout, *values)

    def wire(self, value):
        return value.bytes_le if self.order == "<" else value.bytes

    def call(self, operation, body):
        representation = 0x10 if self.order == "<" else 0
        header = bytes([4, 0, 0x20, 0, representation, 0, 0, 0])
        header += bytes(16) + self.wire(EPM) + self.wire(self.activity)
        header += self.pack("IIIHHHHHBB", 0, 3, self.sequence, operation, 0xFFFF, 0xFFFF, len(body), 0, 0, 0)
        self.socket.sendto(header + body, DEVICE)
        answer, sender = self.socket.recvfrom(4096)
        assert sender == DEVICE, sender
        assert answer[:2] == bytes([4, RESPONSE]) and answer[4] == representation, answer[:8]
        assert answer[40:56] == self.wire(self.activity)
        assert answer[64:68] == self.pack("I", self.sequence)
        assert len(answer) == 80 + struct.unpack(self.order + "H", answer[74:76])[0]
        self.sequence += 1
        return answer[80:]

    def lookup(self, handle):
        # All entries: neither an object nor an interface is given.
        return self.call(LOOKUP, self.pack("IIIII", 0, 0, 0, 0, 0)[:16] + handle + self.pack("I", 1))


for order in "<>":
    client = Client(order)
    first = client.lookup(bytes(20))
    handle = first[:20]
    assert handle != bytes(20)
    counts = struct.unpack(order + "IIII", first[20:36])
    assert counts == (1, 1, 0, 1), counts
    assert first[36:52] == client.wire(OBJECT), first[36:52].hex()
    assert first[64:128].startswith(b"WSG "), first[64:128]
    assert client.pack("I", 0) == first[-4:]
    end = client.lookup(handle)
    assert end[20:24] == bytes(4) and end[-4:] == client.pack("I", NOT_REGISTERED), end.hex()
    freed = client.call(FREE_HANDLE, handle)
    assert freed == bytes(24), freed.hex()
