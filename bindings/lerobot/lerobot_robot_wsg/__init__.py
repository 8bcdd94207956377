"""A WSG gripper for LeRobot: as a robot of its own (``--robot.type=wsg``), or as a part of another robot (``WsgGripper``)."""

from .config_wsg import WsgConfig, WsgGripperConfig
from .wsg import Wsg, WsgGripper

__all__ = ["Wsg", "WsgConfig", "WsgGripper", "WsgGripperConfig"]
