"""Set-points at a fixed rate, from a thread without the interpreter lock."""

from __future__ import annotations

import threading
import time
from types import TracebackType
from typing import NamedTuple, Optional, TypeVar

from ._errors import InvalidError, NotConnectedError
from ._native import Stream, stream_script
from ._types import HomingDirection, Limits, SystemFlags
from ._updates import Subscription

Self = TypeVar("Self", bound="StreamingGripper")


class Sample(NamedTuple):
    """State of the gripper at one instant. Times are values of ``time.time()`` in s, and increase from sample to sample."""

    number: int
    """Sample number, counted from 0."""
    measured: float
    """Time of the measurement, by the gripper's clock or from the estimated latency."""
    received: float
    """Time at which the sample arrived."""
    position: float
    """Opening width in mm."""
    speed: float
    """Finger speed in mm/s; closing is negative."""
    force: float
    """Gripping force in N, summed over both fingers."""
    flags: SystemFlags
    set_point: Optional[float]
    """Commanded position in mm; ``None`` before the first set-point."""

    @property
    def age(self) -> float:
        """Time since the measurement in s, now."""
        return time.time() - self.measured


def _sample(row: tuple[int, float, float, float, float, float, int, Optional[float]]) -> Sample:
    number, measured, received, position, speed, force, flags, set_point = row
    return Sample(number, measured, received, position, speed, force, SystemFlags(flags), set_point)


class Gap(NamedTuple):
    """A time without answers from the gripper, during which the fingers held or finished a segment of 100 ms."""

    begin: float
    """Time at which the first missing answer was due, as a value of ``time.time()`` in s."""
    length: float
    """Time until the next answer in s."""


class StreamingGripper:
    """A gripper that follows set-points, 100 times a second by default.

    ::

        with StreamingGripper("tcp://192.168.1.20") as gripper:
            gripper.schedule_waypoint(60, time.time() + 0.1)
            gripper.schedule_waypoint(40, time.time() + 0.3)
            sample = gripper.latest()

    A thread of its own sends the set-points and receives the state, independently of the interpreter lock. No method but
    ``start``, ``stop``, ``home`` and ``acknowledge`` waits for the gripper.

    With the script :attr:`SCRIPT` or UMI's script on the gripper, a set-point replaces the one before during the motion,
    and the fingers push against a part with the force limit. Without a script, the fingers stop between segments of
    100 ms, and contact turns the motor off. ``docs/python.md`` explains the upload.

    Without new set-points the fingers move to the last one and stay there. If an answer is more than 100 ms late, the
    fingers hold, or finish the segment, and continue when the gripper answers within 1 s: see :meth:`gaps`. A longer gap, a
    FAST STOP, a Stop by another client, a script error or a lost connection ends the stream, and nothing resumes by itself:
    see :attr:`ended` and :meth:`acknowledge`.
    """

    SCRIPT: str = stream_script()
    """Source of ``wsg_stream.lua``, the script for a gripper or for ``Simulator(script=...)``."""

    def __init__(
        self,
        address: str,
        frequency: float = 100,
        *,
        home: Optional[HomingDirection] = HomingDirection.DEFAULT,
        max_speed: Optional[float] = None,
        force: Optional[float] = None,
        queue_size: int = 1024,
    ) -> None:
        """Prepare a stream of ``frequency`` set-points per second, 1 to 500. It connects in :meth:`start`.

        ``home`` references the fingers first, and ``None`` does not. ``max_speed`` in mm/s and ``force`` in N limit the
        motion; the defaults are the maximum speed and the force limit of the gripper. :meth:`start` refuses values outside
        the limits of the gripper before anything moves. At most ``queue_size`` waypoints wait, 1 to 4096.
        """
        if not 1 <= frequency <= 500:
            raise InvalidError(f"frequency is {frequency}; expected 1 to 500 set-points per second")
        if not 1 <= queue_size <= 4096:
            raise InvalidError(f"queue size is {queue_size}; expected 1 to 4096 waypoints")
        self.address = address
        self.frequency = frequency
        self._home = home
        self._max_speed = max_speed
        self._force = force
        self._queue_size = queue_size
        self._stream: Optional[Stream] = None
        self._starting: Optional[threading.Thread] = None
        self._failure: Optional[BaseException] = None

    def __enter__(self: Self) -> Self:
        self.start()
        return self

    def __exit__(
        self,
        kind: Optional[type[BaseException]],
        error: Optional[BaseException],
        traceback: Optional[TracebackType],
    ) -> None:
        self.stop()

    # Start and end

    def start(self, wait: bool = True) -> None:
        """Connect, home and start the stream. Nothing moves afterwards before the first set-point.

        With ``wait=False`` it happens in another thread: call :meth:`start_wait`, or poll :attr:`is_ready`.
        """
        if wait:
            self._open()
        else:
            self._starting = threading.Thread(target=self._open_in_thread, daemon=True)
            self._starting.start()

    def start_wait(self) -> None:
        """Wait for ``start(wait=False)``, and raise its exception if it failed."""
        if self._starting is not None:
            self._starting.join()
            self._starting = None
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def stop(self, wait: bool = True) -> None:
        """Stop the fingers, and end the stream and the connection. With ``wait=False`` only send the stop."""
        if wait or self._stream is None:
            self.stop_wait()
        else:
            self._stream.stop_fingers(False)

    def stop_wait(self) -> None:
        """Wait for the end of the stream. :meth:`history` remains available."""
        if self._starting is not None:
            self._starting.join()
        if self._stream is not None:
            self._stream.close()

    def fast_stop(self) -> None:
        """Stop the fingers as fast as possible and lock them (command set, 3.2.4). This ends the stream."""
        self._running().stop_fingers(True)

    @property
    def is_ready(self) -> bool:
        """Whether the stream has started and not ended."""
        return self._stream is not None and self._stream.ended() is None

    @property
    def ended(self) -> Optional[str]:
        """Cause of the end of the stream; ``None`` while it runs."""
        return self._running().ended()

    @property
    def backend(self) -> str:
        """How the fingers follow the set-points: ``"script"``, ``"umi-script"`` or ``"pre-position"``."""
        return self._running().backend()

    # Set-points

    def schedule_waypoint(self, pos: float, target_time: float) -> None:
        """Move to a position in mm until a time of ``time.time()``, on a straight line from the set-point before.

        It replaces the set-points at the same or a later time. A time in the past is like :meth:`set_target`. The speed
        limit takes precedence.

        Raises ``InvalidError`` for a position outside the stroke and for a time that is more than one hour ahead or in the
        past, such as one in milliseconds; ``BusyError`` if the queue is full; ``StreamEndedError`` after the end of the
        stream. Nothing changes then.
        """
        self._running().schedule(pos, target_time)

    def set_target(self, pos: float) -> None:
        """Move to a position in mm at the speed limit. It replaces all set-points.

        Raises ``InvalidError`` for a position outside the stroke, ``StreamEndedError`` after the end of the stream.
        """
        self._running().set_target(pos)

    def set_speed_limit(self, speed: float) -> None:
        """Limit the speed to a value in mm/s. Raises ``InvalidError`` outside the limits of the gripper."""
        self._running().set_speed_limit(speed)

    def set_force_limit(self, force: float) -> None:
        """Limit the force on contact to a value in N. Raises ``InvalidError`` outside the limits of the gripper.

        The greatest one is the nominal force, or in overdrive mode the overdrive force.
        """
        self._running().set_force_limit(force)

    # Homing and FAST STOP

    def home(self, direction: HomingDirection = HomingDirection.DEFAULT) -> None:
        """Reference the fingers at an end stop while the stream runs, and wait for the end.

        All set-points are dropped, and the fingers stop first. Meanwhile set-points raise ``BusyError``. Nothing moves
        afterwards before the next one. Raises like ``Gripper.home``, and ``StreamEndedError``.
        """
        self._running().home(direction)

    def acknowledge(self) -> None:
        """Acknowledge a FAST STOP or a fault, which unlocks the fingers. Make sure that they may move.

        All set-points are dropped and the fingers stop, so nothing moves before the next set-point. A stream that a FAST STOP has
        ended begins again. After any other end it raises ``StreamEndedError``.
        """
        self._running().acknowledge()

    # State

    def latest(self) -> Sample:
        """Return the latest sample; its ``age`` is less than 1 s while the stream runs.

        Raises ``StreamEndedError`` after the end of the stream, when the sample is no longer current.
        """
        return _sample(self._running().latest())

    def subscribe(self) -> Subscription[Sample]:
        """Iterate over new samples, without polling::

            for sample in gripper.subscribe():
                print(sample.position, sample.force)

        A slow loop gets the latest sample, and :meth:`history` keeps the others. Several loops may run at a time. A loop raises
        ``StreamEndedError`` after the end of the stream.
        """
        return Subscription(self._running().subscribe(), _sample)

    def history(self) -> memoryview[float]:
        """Return the last 1024 samples, oldest first: rows of doubles with the columns of :class:`Sample`.

        ``numpy.asarray(gripper.history())`` makes an array of it without a copy. A missing set-point is NaN. It remains
        available after the end of the stream.
        """
        columns = len(Sample._fields)
        rows = memoryview(self._running().history())
        return rows.cast("d", (len(rows) // (8 * columns), columns)) if rows else rows.cast("d")

    def gaps(self) -> list[Gap]:
        """Return the last 64 gaps, oldest first: answers that were more than 100 ms late."""
        return [Gap(begin, length) for begin, length in self._running().gaps()]

    @property
    def limits(self) -> Limits:
        """Physical limits of the gripper, which positions, speeds and forces must keep."""
        return Limits(*self._running().limits())

    def _running(self) -> Stream:
        if self._stream is None:
            raise NotConnectedError("the stream has not started: call start, or start_wait after start(wait=False)")
        return self._stream

    def _open(self) -> None:
        self._stream = Stream(
            self.address,
            round(self.frequency),
            self._queue_size,
            self._home,
            self._max_speed,
            self._force,
        )

    def _open_in_thread(self) -> None:
        try:
            self._open()
        except BaseException as failure:
            self._failure = failure
