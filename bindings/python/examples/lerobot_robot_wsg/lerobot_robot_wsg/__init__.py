"""A WSG gripper as a robot of LeRobot: ``lerobot-record --robot.type=wsg --robot.address=tcp://192.168.1.20 ...``."""

from .config_wsg import WsgConfig
from .wsg import Wsg

__all__ = ["Wsg", "WsgConfig"]
