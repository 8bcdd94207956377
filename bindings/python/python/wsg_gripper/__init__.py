"""Weiss Robotics WSG servo grippers: drivers, set-point streaming, and a virtual gripper for tests.

- :class:`Gripper`: blocking driver
- :class:`AsyncGripper`: the same for asyncio
- :class:`StreamingGripper`: set-points at a fixed rate, with the state at any time
- :mod:`wsg_gripper.sim`: virtual gripper, for tests and without hardware
- :mod:`wsg_gripper.protocol`: frames and commands without a connection
- :mod:`wsg_gripper.umi`: the interface of UMI's controller
"""

import atexit as _atexit
import logging as _logging
import os as _os
from typing import TYPE_CHECKING as _TYPE_CHECKING

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
from ._streaming import Gap, Sample, StreamingGripper
from ._types import (
    FingerFlags,
    FingerInfo,
    GripperState,
    GripResult,
    HomingDirection,
    Limits,
    Reading,
    SoftLimits,
    Statistics,
    Status,
    SystemFlags,
    SystemInfo,
)
from ._updates import Subscription

if _TYPE_CHECKING:
    from ._async import AsyncGripper, AsyncSubscription

__all__ = [
    "AbortedError",
    "AsyncGripper",
    "AsyncSubscription",
    "BlockedError",
    "BusyError",
    "FingerFlags",
    "FingerInfo",
    "Gap",
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
    "Reading",
    "RefusedError",
    "Sample",
    "SoftLimits",
    "Statistics",
    "Status",
    "StoppedError",
    "StreamEndedError",
    "StreamingGripper",
    "Subscription",
    "SystemFlags",
    "SystemInfo",
    "UnansweredError",
    "UnsupportedError",
]

_logging.getLogger(__name__).addHandler(_logging.NullHandler())
_atexit.register(_native.close_all)
if hasattr(_os, "register_at_fork"):  # not on Windows
    _os.register_at_fork(after_in_child=_native.count_fork)


def __getattr__(name: str) -> object:
    """Import the names for asyncio at their first use, because the import of asyncio takes 50 ms."""
    if name in ("AsyncGripper", "AsyncSubscription"):
        from . import _async

        return getattr(_async, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
