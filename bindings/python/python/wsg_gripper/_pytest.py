"""A plugin for pytest, which finds it by its entry point."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from .sim import Simulator


@pytest.fixture
def wsg_sim() -> Iterator[Simulator]:
    """A virtual gripper on free ports: ``Gripper(wsg_sim.tcp)``. Its fingers move ten times as fast as the real ones."""
    from .sim import Simulator

    with Simulator(time_scale=10) as simulator:
        yield simulator
