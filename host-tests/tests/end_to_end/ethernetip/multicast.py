import socket
import struct

from ethernetip import EtherNetIP

# The adapter is host 2 of its network.
GROUP = "239.192.1.32"

with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
    udp.bind((GROUP, 2222))
    membership = socket.inet_aton(GROUP) + socket.inet_aton("127.0.0.2")
    udp.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    udp.settimeout(60)
    connection = EtherNetIP("127.0.0.2").explicit_conn("127.0.0.2")
    connection.registerSession()
    opening = dict(torpi=20, otrpi=20, inputsz=12, outputsz=8, multiplier=7)
    assert connection.sendFwdOpenReq(100, 150, 151, multicast=True, **opening) == 0
    for sequence in range(1, 11):
        packet, sender = udp.recvfrom(100)
        assert sender == ("127.0.0.2", 2222) and len(packet) == 32, (sender, packet)
        assert struct.unpack_from("<II", packet, 6) == (connection.toconnid, sequence), packet
    assert connection.sendFwdCloseReq(100, 150, 151) == 0
print("passed")
