"""The configuration of a gripper, alone or in another robot."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.robots import RobotConfig
from wsg_gripper import HomingDirection


@dataclass(kw_only=True)
class WsgGripperConfig:
    """A gripper at an address of ``wsg_gripper.Gripper``, over the binary protocol."""

    address: str
    """Such as ``tcp://192.168.1.20``."""
    frequency: float = 30
    """Set-points per second. A real gripper with a script handles 30."""
    max_speed: float = 200
    """Limit of the finger speed in mm/s."""
    force: float = 20
    """Limit of the gripping force in N, summed over both fingers."""
    home_on_connect: bool = False
    """Whether ``connect`` moves the fingers to an end stop if the gripper is not referenced."""
    homing_direction: HomingDirection = HomingDirection.DEFAULT
    """End stop of ``home_on_connect`` and ``calibrate``."""


@RobotConfig.register_subclass("wsg")
@dataclass(kw_only=True)
class WsgConfig(WsgGripperConfig, RobotConfig):
    """A gripper as a robot."""
