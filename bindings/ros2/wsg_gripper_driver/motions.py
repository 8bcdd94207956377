"""Motions of a gripper, one at a time. No ROS."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager, suppress
from itertools import count
from typing import Callable, Iterator, Optional, TypeVar

from wsg_gripper import BlockedError, BusyError, Gripper, GripperError, GripperState, Motion, MotionError, UnansweredError

T = TypeVar("T")

# Time between two polls of a motion in s.
POLL_PERIOD = 0.02
# Distance in mm by which the nominal width of a grip is smaller than the contact. From an equal width, the gripper may open the
# fingers to grip from inside. It is less than the part width tolerance.
CONTACT_MARGIN = 0.5


class Halted(GripperError):
    """A stop, the end of the node or a cancelled goal ended the motion. The message is the reason."""


class NoPart(GripperError):
    """A grip found no part (NO_PART)."""


class Motions:
    """Admits one motion at a time. A halt ends it, also between two of its requests."""

    def __init__(self) -> None:
        self._running = threading.Lock()
        # No two halts, which threads may request at the same time, have the same number.
        self._numbers = count(1)
        self.halts, self.reason = 0, ""

    @contextmanager
    def run(self, halts: Optional[int] = None) -> Iterator[Run]:
        """Claim the gripper for a motion that was requested after ``halts`` halts, or now.

        Raises ``BusyError`` while another one runs, and ``Halted`` after another halt.
        """
        if not self._running.acquire(blocking=False):
            raise BusyError("another motion is running")
        try:
            run = Run(self, self.halts if halts is None else halts)
            run.check()
            yield run
        finally:
            self._running.release()

    @property
    def is_running(self) -> bool:
        return self._running.locked()

    def halt(self, reason: str) -> None:
        """End the running motion. The thread that runs it stops the fingers."""
        self.reason = reason
        self.halts = next(self._numbers)

    def halt_and_wait(self, reason: str) -> None:
        """End the running motion and wait for its end, up to 3 s."""
        self.halt(reason)
        if self._running.acquire(timeout=3):
            self._running.release()


class Run:
    """The permission for one motion."""

    def __init__(self, motions: Motions, halts: int) -> None:
        self._motions, self.halts = motions, halts
        self.is_cancelled: Callable[[], bool] = lambda: False
        self.tick: Callable[[], None] = lambda: time.sleep(POLL_PERIOD)
        """Called while the fingers move."""

    def check(self) -> None:
        """Raise ``Halted`` after a halt, and after a cancellation."""
        if self._motions.halts != self.halts:
            raise Halted(self._motions.reason)
        if self.is_cancelled():
            raise Halted("the client cancelled the goal")

    def wait(self, gripper: Gripper, begin: Callable[[], Motion[T]]) -> T:
        """Begin a motion and return its result. Stops the fingers if it cannot wait for the end."""
        self.check()
        try:
            motion = begin()
            while (result := motion.poll()) is None:
                self.check()
                self.tick()
            return result[0]
        except BaseException as error:
            # Other errors mean that nothing moves.
            if isinstance(error, (Halted, UnansweredError)) or not isinstance(error, GripperError):
                with suppress(GripperError):
                    gripper.stop()
            self.check()
            raise


def close_on(run: Run, gripper: Gripper, width: float, speed: float, force: float, is_width_known: bool) -> bool:
    """Close the fingers and grip with a force in N. Return whether a part is held; false means no contact.

    Without a known width, the fingers move to a width in mm, and grip at the width of the contact: a grip at a smaller
    nominal width would report NO_PART. Raises ``NoPart`` if the grip finds no part.
    """
    if not is_width_known:
        if gripper.state() is not GripperState.HOLDING:
            gripper.set_force_limit(force)
            try:
                run.wait(gripper, lambda: gripper.begin_move(width, speed))
                return False
            except BlockedError:
                pass
        width = max(0.0, gripper.width() - CONTACT_MARGIN)
    if not run.wait(gripper, lambda: gripper.begin_grip(width, speed, force)):
        raise NoPart("NO_PART: the fingers hold no part")
    return True


def move_to(run: Run, gripper: Gripper, width: float, speed: float) -> None:
    """Move the fingers to a width in mm without gripping. A held part is released, for which they must open."""
    if gripper.state() is not GripperState.HOLDING:
        run.wait(gripper, lambda: gripper.begin_move(width, speed))
    elif width > gripper.width():
        run.wait(gripper, lambda: gripper.begin_release(width, speed))
    else:
        raise MotionError("a part is held: to close further, request an effort; to release it, open the fingers")
