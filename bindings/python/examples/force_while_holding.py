"""Force while holding: reads the state while the fingers close, and the force afterwards. The part then slips out."""

from __future__ import annotations

import time

from wsg_gripper import Gripper, GripperState
from wsg_gripper.sim import Simulator

with Simulator(part=20) as simulator, Gripper(simulator.tcp) as gripper:
    gripper.home()
    motion = gripper.begin_grip(20, speed=100, force=30)
    while not motion.done():
        print(f"{gripper.width():6.1f} mm")
        time.sleep(0.1)
    print(motion.wait())
    while gripper.state() is GripperState.HOLDING:
        force = gripper.force()
        print(f"{force:6.1f} N")
        simulator.set_part(None)
        time.sleep(0.1)
    print(gripper.state().name)
