"""Motions of a gripper, one at a time. No ROS."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from typing import Callable, Iterator, Optional, TypeVar

from wsg_gripper import BlockedError, BusyError, Gripper, GripperError, GripperState, Motion, MotionError

T = TypeVar("T")

POLL_PERIOD = 0.02
"""Time between two polls of a motion in s."""


class Halted(GripperError):
    """A stop, the end of the node or a cancelled goal ended the motion. The message is the reason."""


class Run:
    """Permission for the requests of one motion. A halt ends it, also between two of its requests."""

    def __init__(self, motions: Motions) -> None:
        self._motions = motions
        self._halts = motions.halts
        self.tick: Callable[[], None] = lambda: time.sleep(POLL_PERIOD)
        """Called while the fingers move."""

    def check(self) -> None:
        """Raise ``Halted`` after a halt."""
        if self._motions.halts != self._halts:
            raise Halted(self._motions.reason)

    def wait(self, gripper: Gripper, begin: Callable[[], Motion[T]]) -> T:
        """Begin a motion and return its result. Raises ``Halted`` with the fingers stopped."""
        self.check()
        try:
            motion = begin()
            while True:
                if self._motions.halts != self._halts:
                    gripper.stop()
                result = motion.poll()
                self.check()
                if result is not None:
                    return result[0]
                self.tick()
        except GripperError:
            self.check()
            raise


class Motions:
    """Admits one motion at a time."""

    def __init__(self) -> None:
        self._running = threading.Lock()
        self.halts = 0
        self.reason = ""

    @contextmanager
    def run(self) -> Iterator[Run]:
        """Claim the gripper for a motion. Raises ``BusyError`` while another one runs."""
        if not self._running.acquire(blocking=False):
            raise BusyError("another motion is running")
        try:
            yield Run(self)
        finally:
            self._running.release()

    @property
    def is_running(self) -> bool:
        return self._running.locked()

    def halt(self, reason: str) -> None:
        """End the running motion. The thread that runs it stops the fingers."""
        self.reason = reason
        self.halts += 1

    def halt_and_wait(self, reason: str, seconds: float = 3) -> None:
        """End the running motion and wait for its end."""
        self.halt(reason)
        if self._running.acquire(timeout=seconds):
            self._running.release()


def close_on(
    run: Run, gripper: Gripper, width: float, speed: float, force: float, is_width_known: bool
) -> Optional[bool]:
    """Close the fingers and grip with a force in N. Return whether a part is held; ``None`` if there was no contact.

    Without a known width, the fingers move to a width in mm, and grip at the width of the contact: a grip at a smaller
    nominal width would return NO_PART.
    """
    if not is_width_known and gripper.state() is GripperState.HOLDING:
        width, is_width_known = gripper.width(), True
    if not is_width_known:
        gripper.set_force_limit(force)
        try:
            run.wait(gripper, lambda: gripper.begin_move(width, speed))
            return None
        except BlockedError:
            width = gripper.width()
    return bool(run.wait(gripper, lambda: gripper.begin_grip(width, speed, force)))


def move_to(run: Run, gripper: Gripper, width: float, speed: float) -> None:
    """Move the fingers to a width in mm without gripping. A held part is released, for which they must open."""
    if gripper.state() is GripperState.HOLDING:
        if width < gripper.width():
            raise MotionError("a part is held: to close further, request an effort; to release it, open the fingers")
        run.wait(gripper, lambda: gripper.begin_release(width, speed))
    else:
        run.wait(gripper, lambda: gripper.begin_move(width, speed))
