"""Round trip of a query over loopback, beside a driver in pure Python, in one run.

``python query.py [NUMBER]`` starts ``wsg-sim`` as a process of its own. ``Plain`` has the calls of the pure Python drivers that
labs use: one socket, one request at a time. In a second part, a Python thread computes beside it.
"""

from __future__ import annotations

import asyncio
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

from wsg_gripper import AsyncGripper, Gripper, StreamingGripper

NUMBER = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
ROUNDS = 20

CRC = []
for byte in range(256):
    value = byte << 8
    for _ in range(8):
        value = (value << 1 ^ 0x1021 if value & 0x8000 else value << 1) & 0xFFFF
    CRC.append(value)


def checksum(data: bytes) -> int:
    value = 0xFFFF
    for byte in data:
        value = CRC[(value ^ byte) & 0xFF] ^ value >> 8
    return value


class Plain:
    """A driver in pure Python."""

    def __init__(self, address: str) -> None:
        host, port = address.split("//")[1].split(":")
        self.socket = socket.create_connection((host, int(port)))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def width(self) -> float:
        frame = struct.pack("<3sBH3s", b"\xaa\xaa\xaa", 0x43, 3, b"\0\0\0")
        self.socket.sendall(frame + struct.pack("<H", checksum(frame)))
        reply = b""
        while len(reply) < 14:
            reply += self.socket.recv(1024)
        assert checksum(reply) == 0 or struct.unpack("<H", reply[-2:])[0] == checksum(reply[:-2])
        status, width = struct.unpack("<Hf", reply[6:12])
        assert status == 0
        return float(width)


def report(name: str, times: list[float]) -> None:
    times.sort()
    median, late = times[len(times) // 2], times[len(times) * 99 // 100]
    print(f"{name:48} median {median * 1e6:8.1f} us   p99 {late * 1e6:8.1f} us   longest {times[-1] * 1e6:8.1f} us")


def measure(calls: dict[str, Callable[[], object]]) -> None:
    """Alternate between the calls, so that other programs of the computer affect all of them."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(ROUNDS):
        for name, call in calls.items():
            for _ in range(NUMBER // ROUNDS):
                begin = time.perf_counter()
                call()
                times[name].append(time.perf_counter() - begin)
    for name, of_call in times.items():
        report(name, of_call)


async def measure_async(name: str, call: Callable[[], Awaitable[object]]) -> None:
    times = []
    for _ in range(NUMBER):
        begin = time.perf_counter()
        await call()
        times.append(time.perf_counter() - begin)
    report(name, times)


async def measure_both(address: str) -> None:
    plain = Plain(address)
    await measure_async("pure Python in asyncio.to_thread", lambda: asyncio.to_thread(plain.width))
    async with AsyncGripper(address) as gripper:
        await measure_async("AsyncGripper", gripper.width)


def compute(ended: threading.Event) -> None:
    while not ended.is_set():
        sum(range(1_000))


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "wsg_stream.lua"
        script.write_text(StreamingGripper.SCRIPT)
        program = str(Path(sys.executable).parent / "wsg-sim")
        command = [program, "--tcp", "127.0.0.1:0", "--script", str(script), "--no-disconnect-error"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as simulator:
            try:
                assert simulator.stdout is not None
                simulator.stdout.readline()
                address = f"tcp://{simulator.stdout.readline().split()[1]}"
                plain = Plain(address)
                with Gripper(address) as gripper:
                    measure({"pure Python": plain.width, "Gripper": gripper.width})
                asyncio.run(measure_both(address))
                with StreamingGripper(address) as stream:
                    print(f"back-end: {stream.backend}")
                    measure({"StreamingGripper.latest": stream.latest})
                    ended = threading.Event()
                    thread = threading.Thread(target=compute, args=(ended,))
                    thread.start()
                    measure({"StreamingGripper.latest, beside a computing thread": stream.latest})
                    ended.set()
                    thread.join()
            finally:
                simulator.terminate()


main()
