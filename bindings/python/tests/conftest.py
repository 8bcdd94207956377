"""The part between the fingers of the simulators, and a watchdog: a test that hangs fails."""

from __future__ import annotations

import faulthandler
import signal
from collections.abc import Iterator

import pytest
from pauses import pytest_runtest_protocol  # noqa: F401

from wsg_gripper import Gripper
from wsg_gripper.sim import Simulator, VirtualGripper

faulthandler.dump_traceback_later(600, exit=True)
# A shell starts background jobs with SIGINT ignored, and Python then raises no KeyboardInterrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def virtual() -> VirtualGripper:
    """A gripper in virtual time with a part of 20 mm."""
    return VirtualGripper(part=20)


@pytest.fixture
def gripper(virtual: VirtualGripper) -> Iterator[Gripper]:
    """A referenced gripper in virtual time."""
    with virtual.connect() as gripper:
        gripper.home()
        yield gripper


@pytest.fixture
def simulator() -> Iterator[Simulator]:
    """A gripper on sockets with a part of 20 mm, whose fingers move slowly enough to be interrupted."""
    with Simulator(part=20, homing_speed=400) as simulator:
        yield simulator
