"""Weiss Robotics WSG servo grippers: drivers, set-point streaming, and a virtual gripper for tests.

- :class:`Gripper`: blocking driver
- :class:`StreamingGripper`: set-points at a fixed rate, with the state at any time
- :mod:`wsg_gripper.sim`: virtual gripper, for tests and without hardware
"""

import atexit as _atexit

from . import _native
from ._errors import (
    AbortedError,
    BlockedError,
    BusyError,
    GripperError,
    InvalidError,
    MismatchError,
    MotionError,
    NotConnectedError,
    RefusedError,
    StoppedError,
    StreamEndedError,
    UnansweredError,
    UnsupportedError,
)
from ._gripper import Gripper, Motion
from ._streaming import Sample, StreamingGripper
from ._types import (
    FingerFlags,
    FingerInfo,
    GripperState,
    GripResult,
    HomingDirection,
    Limits,
    SoftLimits,
    Statistics,
    Status,
    SystemFlags,
    SystemInfo,
)

__all__ = [
    "AbortedError",
    "BlockedError",
    "BusyError",
    "FingerFlags",
    "FingerInfo",
    "GripResult",
    "Gripper",
    "GripperError",
    "GripperState",
    "HomingDirection",
    "InvalidError",
    "Limits",
    "MismatchError",
    "Motion",
    "MotionError",
    "NotConnectedError",
    "RefusedError",
    "Sample",
    "SoftLimits",
    "Statistics",
    "Status",
    "StoppedError",
    "StreamEndedError",
    "StreamingGripper",
    "SystemFlags",
    "SystemInfo",
    "UnansweredError",
    "UnsupportedError",
]

_atexit.register(_native.close_all)
