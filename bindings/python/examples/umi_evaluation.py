"""The gripper part of UMI's evaluation, with one import changed.

``UmiEnv`` starts the controller without waiting, schedules waypoints from the actions of a policy, and reads all states for
an observation. In UMI's ``real_world/umi_env.py`` the only change is the import of ``WSGController``.

``python umi_evaluation.py`` runs on a simulated gripper; pass the host of yours, such as 192.168.1.20.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from wsg_gripper import StreamingGripper
from wsg_gripper.sim import Simulator
from wsg_gripper.umi import WSGController  # was: from umi.real_world.wsg_controller import WSGController

FREQUENCY = 10.0
HORIZON = 2


def evaluate(host: str, port: int) -> None:
    gripper = WSGController(shm_manager=None, hostname=host, port=port, receive_latency=0.01, use_meters=True)
    gripper.start(wait=False)
    gripper.start_wait()
    try:
        for step in range(20):
            # An observation: the states of the camera's times, interpolated from the history.
            states = gripper.get_all_state()
            times = time.time() - np.arange(HORIZON)[::-1] / FREQUENCY
            widths = np.interp(times, states["gripper_timestamp"], states["gripper_position"])
            # A policy: here it closes the fingers by 2 mm a step.
            action = widths[-1] - 0.002
            gripper.schedule_waypoint(action, time.time() + 1 / FREQUENCY)
            time.sleep(1 / FREQUENCY)
        print(f"closed to {gripper.get_state()['gripper_position']:.3f} m")
    finally:
        gripper.stop()


if len(sys.argv) > 1:
    evaluate(sys.argv[1], 1000)
else:
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "wsg_stream.lua"
        script.write_text(StreamingGripper.SCRIPT)
        with Simulator(script=script, homing_speed=400) as simulator:
            simulator.wait_for_script()
            host, port = simulator.tcp.split("//")[1].split(":")
            evaluate(host, int(port))
