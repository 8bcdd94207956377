"""First grip: ``python first_grip.py`` on a simulated gripper, or with the address of yours, such as tcp://192.168.1.20."""

from __future__ import annotations

import sys

from wsg_gripper import Gripper
from wsg_gripper.sim import Simulator


def grip(address: str) -> None:
    with Gripper(address) as gripper:
        print(gripper.info())
        gripper.home()
        if gripper.grip(20, speed=100, force=40):
            print(f"holds a part of {gripper.width():.1f} mm with {gripper.force():.1f} N")
        else:
            print("no part")
        gripper.release(60, speed=200)


if len(sys.argv) > 1:
    grip(sys.argv[1])
else:
    with Simulator(part=20) as simulator:
        grip(simulator.tcp)
