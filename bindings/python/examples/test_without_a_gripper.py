"""A test of a program without a gripper and without waiting: run ``pytest test_without_a_gripper.py``."""

from __future__ import annotations

import pytest

from wsg_gripper import Gripper, GripperState, MotionError
from wsg_gripper.sim import Fault, Simulator, VirtualGripper


def pick(gripper: Gripper) -> bool:
    """The program under test: grips a part of 20 mm, and opens the fingers if no part is there."""
    if gripper.grip(20, speed=100):
        return True
    gripper.release(60, speed=200)
    return False


def test_pick_holds_the_part() -> None:
    virtual = VirtualGripper(part=20)
    with virtual.connect() as gripper:
        gripper.home()
        assert pick(gripper)
        assert virtual.observe().state is GripperState.HOLDING


def test_pick_opens_without_a_part() -> None:
    virtual = VirtualGripper()
    with virtual.connect() as gripper:
        gripper.home()
        assert not pick(gripper)
        assert virtual.observe().width == pytest.approx(60, abs=0.1)


def test_jam_is_an_error() -> None:
    virtual = VirtualGripper(part=20)
    with virtual.connect() as gripper:
        gripper.home()
        virtual.set_fault(Fault.AXIS_BLOCKED)
        with pytest.raises(MotionError):
            gripper.release(60, speed=200)


def test_over_tcp(wsg_sim: Simulator) -> None:
    """The fixture ``wsg_sim`` needs no import of its own."""
    wsg_sim.set_part(20)
    with Gripper(wsg_sim.tcp) as gripper:
        gripper.home()
        assert pick(gripper)
