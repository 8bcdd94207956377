"""Regularity of a stream at 100 Hz, beside a thread that computes 5 ms for each image of a camera at 30 Hz.

``python streaming.py [SECONDS]`` starts ``wsg-sim`` as a process of its own.
"""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy

from wsg_gripper import StreamingGripper

SECONDS = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
RATE = 100


def camera(ended: threading.Event) -> None:
    while not ended.wait(1 / 30):
        end = time.perf_counter() + 0.005
        while time.perf_counter() < end:
            pass


def received(address: str) -> numpy.ndarray[tuple[int], numpy.dtype[numpy.float64]]:
    """Return the times at which the samples arrived."""
    with StreamingGripper(address, RATE) as gripper:
        times: dict[float, float] = {}
        begin = time.time()
        while time.time() < begin + SECONDS:
            seconds = time.time() - begin
            gripper.schedule_waypoint(80 + 20 * math.cos(seconds * math.pi), time.time() + 0.1)
            rows = numpy.array(gripper.history())
            times.update(zip(rows[-50:, 0], rows[-50:, 2]))
            time.sleep(0.1)
        assert gripper.ended is None, gripper.ended
        return numpy.array([times[number] for number in sorted(times)])


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "wsg_stream.lua"
        script.write_text(StreamingGripper.SCRIPT)
        program = str(Path(sys.executable).parent / "wsg-sim")
        command = [program, "--tcp", "127.0.0.1:0", "--script", str(script)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as simulator:
            assert simulator.stdout is not None
            simulator.stdout.readline()
            address = f"tcp://{simulator.stdout.readline().split()[1]}"
            ended = threading.Event()
            thread = threading.Thread(target=camera, args=(ended,))
            thread.start()
            periods = numpy.diff(received(address)) * RATE
            ended.set()
            thread.join()
            simulator.terminate()
    print(f"{len(periods)} periods, {100 * (periods < 1.5).mean():.2f} % within 1.5, longest {periods.max():.2f}")


main()
