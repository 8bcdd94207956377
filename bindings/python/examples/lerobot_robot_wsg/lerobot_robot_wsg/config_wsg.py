"""The configuration of the robot."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.robots import RobotConfig


@RobotConfig.register_subclass("wsg")
@dataclass(kw_only=True)
class WsgConfig(RobotConfig):
    """A gripper at an address of ``wsg_gripper.Gripper``, over the binary protocol."""

    address: str = "tcp://192.168.1.20"
    frequency: float = 100
    """Set-points per second. 30 suits a script on a real gripper."""
    max_speed: float = 200
    """Limit of the finger speed in mm/s."""
    force: float = 20
    """Limit of the gripping force in N, summed over both fingers."""
