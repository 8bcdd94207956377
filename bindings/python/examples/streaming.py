"""Streaming: the fingers follow a cosine of 20 mm, while the program reads their state.

``python streaming.py`` runs on a simulated gripper; pass the address of yours, such as tcp://192.168.1.20.
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from pathlib import Path

from wsg_gripper import StreamingGripper
from wsg_gripper.sim import Simulator

SECONDS = 2.0


def follow_a_cosine(address: str) -> None:
    with StreamingGripper(address, force=20) as gripper:
        print(f"back-end: {gripper.backend}")
        begin = time.time() + 0.5
        for step in range(int(SECONDS * 20)):
            seconds = step / 20
            gripper.schedule_waypoint(80 + 20 * math.cos(seconds * math.pi), begin + seconds)
        while gripper.ended is None and time.time() < begin + SECONDS:
            sample = gripper.latest()
            print(f"{sample.measured - begin:6.2f} s {sample.position:6.1f} mm {sample.force:5.1f} N")
            time.sleep(0.2)
        history = gripper.history()  # with NumPy: numpy.asarray(history)[:, 3]
        positions = [history[row, 3] for row in range(len(history))]
        print(f"{len(positions)} samples from {min(positions):.0f} to {max(positions):.0f} mm")


if len(sys.argv) > 1:
    follow_a_cosine(sys.argv[1])
else:
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "wsg_stream.lua"
        script.write_text(StreamingGripper.SCRIPT)
        with Simulator(script=script) as simulator:
            simulator.wait_for_script()
            follow_a_cosine(simulator.tcp)
