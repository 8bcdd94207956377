"""Motions in virtual time, without ROS."""

from __future__ import annotations

import pytest
from wsg_gripper import BlockedError, BusyError, GripperState
from wsg_gripper.sim import VirtualGripper
from wsg_gripper_driver.motions import Halted, Motions, close_on, move_to


@pytest.mark.parametrize("speed", [10, 400])
@pytest.mark.parametrize("part", [2.0, 61.3])
def test_contact_grip_holds_parts_of_any_width(part: float, speed: float) -> None:
    virtual = VirtualGripper(part=part)
    with virtual.connect() as gripper:
        gripper.home()
        for force in (5, 20, 80):
            with Motions().run() as run:
                run.tick = lambda: virtual.pass_time(0.0137)
                for _ in ("open", "held already"):
                    assert close_on(run, gripper, 0, speed, force, is_width_known=False)
                    assert virtual.observe().force == pytest.approx(force, rel=0.05)
                    assert gripper.state() is GripperState.HOLDING
                move_to(run, gripper, part + 10, speed)


def test_nothing_begins_after_a_halt_or_a_cancellation_and_a_failure_stops_the_fingers() -> None:
    virtual, motions = VirtualGripper(part=20), Motions()

    def fail() -> None:
        virtual.pass_time(0.1)
        raise RuntimeError("a defect")

    with virtual.connect() as gripper:
        gripper.home()
        with motions.run() as run:
            run.tick = fail
            with pytest.raises(RuntimeError, match="a defect"):
                run.wait(gripper, lambda: gripper.begin_move(50, 10))
            virtual.pass_time(0.1)
            assert virtual.observe().speed == 0
            with pytest.raises(BusyError), motions.run():
                pass
            with pytest.raises(BlockedError):
                gripper.move(0, 100)
            run.is_cancelled = lambda: True
            with pytest.raises(Halted, match="cancelled"):
                run.wait(gripper, lambda: gripper.begin_grip(20, 100))
            motions.halt("a stop")
            with pytest.raises(Halted, match="a stop"):
                run.wait(gripper, lambda: gripper.begin_grip(20, 100))
        with pytest.raises(Halted, match="a stop"), motions.run(run.halts):
            pass
        virtual.pass_time(1)
        assert virtual.observe().force == 0
