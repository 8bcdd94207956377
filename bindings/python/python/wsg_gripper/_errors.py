"""Exceptions, by cause. All derive from :class:`GripperError`."""

from __future__ import annotations

from typing import Optional

from ._types import Status


class GripperError(Exception):
    """A request failed. ``status`` is the status code of the gripper, if it sent one (command set, appendix A)."""

    status: Optional[Status]

    def __init__(self, message: str, status: Optional[int] = None) -> None:
        super().__init__(message)
        self.status = None if status is None else Status(status)


class NotConnectedError(GripperError, ConnectionError):
    """There is no connection: it could not be opened, it failed, or it is closed."""


class UnansweredError(GripperError, TimeoutError):
    """The request was sent and not answered in time, so its outcome is unknown."""


class InvalidError(GripperError, ValueError):
    """A parameter is outside the limits of the gripper, or has a value that no gripper accepts. Nothing was changed."""


class UnsupportedError(GripperError):
    """The protocol of this connection does not have the request. Nothing was sent."""


class BusyError(GripperError):
    """Another motion is running, or a FAST STOP is not confirmed yet. Nothing was sent."""


class RefusedError(GripperError):
    """The gripper refused the request with ``status``.

    E_NOT_INITIALIZED: call ``home`` first. E_ACCESS_DENIED: usually FAST STOP; call ``acknowledge`` once the fingers may
    move. E_RANGE_ERROR: a width is outside the soft limits.
    """


class MismatchError(GripperError):
    """The gripper returned another value than the one sent: a setting read back, or the data of ``loop_back``.

    The gripper keeps the value of the setting that was read back. A grip did not begin.
    """


class MotionError(GripperError):
    """A motion began and failed with ``status``."""


class BlockedError(MotionError):
    """An obstacle blocked the fingers (E_AXIS_BLOCKED)."""


class AbortedError(MotionError):
    """Stop, FAST STOP or another client ended the motion (E_CMD_ABORTED)."""


class StoppedError(MotionError):
    """``stop`` or ``fast_stop`` of this program, called in another thread or task, ended the request or the motion."""


class StreamEndedError(GripperError):
    """The stream of set-points has ended. The message is the cause."""
