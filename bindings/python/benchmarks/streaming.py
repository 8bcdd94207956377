"""Regularity of a stream at 100 Hz, beside a thread that computes 5 ms for each image of a camera at 30 Hz.

``python streaming.py [SECONDS] [PRIORITY]`` starts ``wsg-sim`` as a process of its own. Another process only sleeps at
100 Hz: the stream cannot be more regular than it. With a PRIORITY, the stream, ``wsg-sim`` and the sleeping process have
this real-time priority; the camera's thread never has.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy

from wsg_gripper import StreamingGripper

SECONDS = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
PRIORITY = int(sys.argv[2]) if len(sys.argv) > 2 else 0
RATE = 100

Times = numpy.ndarray[tuple[int], numpy.dtype[numpy.float64]]

SLEEP = f"""
import time
times = []
begin = time.perf_counter()
for tick in range(int({SECONDS * RATE})):
    time.sleep(max(0, begin + tick / {RATE} - time.perf_counter()))
    times.append(time.perf_counter())
print(*times)
"""


def camera(ended: threading.Event) -> None:
    while not ended.wait(1 / 30):
        end = time.perf_counter() + 0.005
        while time.perf_counter() < end:
            pass


def received(gripper: StreamingGripper) -> Times:
    """Return the times at which the samples arrived."""
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


def report(what: str, times: Times) -> None:
    periods = numpy.diff(times) * RATE
    within = 100 * (periods < 1.5).mean()
    print(f"{what}: {len(periods)} periods, {within:.2f} % within 1.5, longest {periods.max():.2f}")


def main() -> None:
    ended = threading.Event()
    thread = threading.Thread(target=camera, args=(ended,))
    thread.start()
    if PRIORITY:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "wsg_stream.lua"
        script.write_text(StreamingGripper.SCRIPT)
        program = str(Path(sys.executable).parent / "wsg-sim")
        command = [program, "--tcp", "127.0.0.1:0", "--script", str(script)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as simulator:
            try:
                assert simulator.stdout is not None
                simulator.stdout.readline()
                address = f"tcp://{simulator.stdout.readline().split()[1]}"
                with StreamingGripper(address, RATE) as gripper:
                    with subprocess.Popen([sys.executable, "-c", SLEEP], stdout=subprocess.PIPE, text=True) as sleeping:
                        if PRIORITY:
                            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
                        report("stream", received(gripper))
                        ended.set()
                        assert sleeping.stdout is not None
                        report("sleep", numpy.array([float(word) for word in sleeping.stdout.read().split()]))
            finally:
                simulator.terminate()
    thread.join()


main()
