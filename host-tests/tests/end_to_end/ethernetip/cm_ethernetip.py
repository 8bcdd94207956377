import asyncio

from ethernetip.protocol.eip_scanner import EipScanner
from ethernetip.protocol.eip_udp_transport import EipUdpTransport
from ethernetip.protocol.forward_open_config import ForwardOpenConfig


async def cycle():
    scanner = EipScanner()
    await scanner.connect("127.0.0.2")
    revision = bytes([0x20, 1, 0x24, 1, 0x30, 4])
    connected = await scanner.open_explicit()
    answers = [await scanner.send_explicit(0x0E, revision), await connected.send_raw(0x0E, revision)]
    assert [answer.data for answer in answers] == [bytes([1, 1])] * 2, answers
    await connected.close()
    # Without a socket address item, T->O data comes to port 2222.
    await scanner.udp.close()
    scanner._udp = EipUdpTransport("127.0.0.1", 2222)
    await scanner.udp.start()
    # Its sizes lack the sequence count, so they are larger by 2.
    config = ForwardOpenConfig(consumed_assembly=150, produced_assembly=100, config_assembly=151, consumed_size=10,
                               produced_size=14, rpi=20_000, timeout_multiplier=7)
    connection = await scanner.forward_open(config)
    connection._consumed_data = bytearray(8)
    await asyncio.to_thread(run, lambda: connection.produced_data[:12], connection.set_consumed_data)
    await connection.close()
    await scanner.close()


asyncio.run(cycle())
print("cycle done")
