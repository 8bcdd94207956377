"""The connection to a gripper. A thread connects, reads the state, and connects again after a loss.

By itself, it requests only the state and its automatic updates. ``Requests.read`` and ``Stream.read`` are the only places that read
the state.
"""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from math import inf, nan
from typing import Callable, NamedTuple, Optional, Union

from wsg_gripper import BusyError, Gripper, GripperError, Limits, NotConnectedError, StoppedError, StreamEndedError
from wsg_gripper import StreamingGripper, SystemFlags, UnansweredError, UnsupportedError

# Shortest time in s between two updates of width, speed and force: a real gripper sends no more values.
SHORTEST_INTERVAL = 0.024
# Time in s between two queries of the temperature, which is not updated automatically.
TEMPERATURE_PERIOD = 1.0
# Checks for the next sample in each period of a stream.
CHECKS = 10
# Age from which the sample of a stream counts as a lost connection. The stream itself ends after 1 s.
LATE = 0.7
# Longest wait for a connection, more than the time-out of the driver.
OPENING = 5.0
# Longest wait for the confirmation of a stop that ends a stream.
CONFIRMATION = 1.0


class Reading(NamedTuple):
    """State of the gripper, in mm, mm/s, N and °C. Closing has a negative speed.

    ``at`` is a time of ``time.monotonic()``, which setting the clock does not change.
    """

    at: float
    width: float
    speed: float
    force: float
    flags: SystemFlags
    state: str
    """Grip state of the manual, or ``STREAMING``."""
    temperature: Optional[float]


class Requests:
    """A connection for single requests."""

    def __init__(self, address: str, rate: float) -> None:
        self.gripper = Gripper(address)
        self._temperature_due = 0.0
        try:
            info = self.gripper.info()
            self.device = f"{info.device} {info.serial_number}"
            self.limits = self._limits()
            self._updates = self.gripper.subscribe(max(1 / rate, SHORTEST_INTERVAL))
            self.first = self.read()
        except BaseException:
            self.gripper.close()
            raise

    def _limits(self) -> Limits:
        try:
            return self.gripper.limits()
        except UnsupportedError:
            # The text protocol has no query for them. The driver and the gripper refuse values outside the limits.
            return Limits(inf, 0, inf, 0, inf, 0, inf, inf)

    def read(self) -> Reading:
        """Wait for new values. Raises ``NotConnectedError``, ``UnansweredError`` or ``StoppedError``.

        The driver notices within 0.8 s that the gripper does not respond.
        """
        if time.monotonic() >= self._temperature_due:
            self._temperature = self.gripper.temperature()
            self._temperature_due = time.monotonic() + TEMPERATURE_PERIOD
        reading = next(self._updates)
        at = time.monotonic() - max(0.0, reading.age)
        _, width, speed, force, state, flags = reading
        return Reading(at, nan if width is None else width, speed, force, flags, state.name, self._temperature)

    def halt(self, fast: bool) -> None:
        """Stop the fingers, and wait for the confirmation."""
        if fast:
            self.gripper.fast_stop()
        else:
            self.gripper.stop()

    def close(self) -> None:
        self.gripper.close()


class Stream:
    """A connection that streams set-points. It never homes and never acknowledges."""

    def __init__(self, address: str, rate: float, speed: float, force: float) -> None:
        self.gripper = StreamingGripper(address, rate, home=None, max_speed=speed, force=force)
        self.gripper.start()
        if self.gripper.ended is not None:
            self.gripper.stop()
            raise StreamEndedError(self.gripper.ended)
        self.limits = self.gripper.limits
        self._number, self._period = -1, 1 / rate
        self._due = self._received = time.monotonic()

    def read(self) -> Reading:
        """Wait for a new sample, at most one in each period. Raises ``StreamEndedError``, or ``UnansweredError`` if it is late."""
        # A sample of the same rate may be early by half a period.
        time.sleep(max(0, self._due - self._period / 2 - time.monotonic()))
        while (sample := self.gripper.latest()).number == self._number:
            if time.monotonic() - self._received > LATE:
                raise UnansweredError(f"no answer for {LATE} s")
            time.sleep(self._period / CHECKS)
        self._number, self._received = sample.number, time.monotonic()
        self._due = max(self._due, self._received) + self._period
        return Reading(self._received - max(0.0, sample.age), *sample[3:7], "STREAMING", None)  # position, speed, force, flags

    def halt(self, fast: bool) -> None:
        """Stop the fingers, and wait until this has ended the stream. Raises ``StreamEndedError`` if it ended otherwise."""
        if fast:
            self.gripper.fast_stop()
        else:
            self.gripper.stop(wait=False)
        end = time.monotonic() + CONFIRMATION
        while (cause := self.gripper.ended) is None:
            if time.monotonic() > end:
                raise UnansweredError("the gripper did not confirm the stop")
            time.sleep(0.001)
        if "stop handle" not in cause:
            raise StreamEndedError(cause)

    def close(self) -> None:
        self.gripper.stop()


Source = Union[Requests, Stream]


class Link:
    """A connection that is kept: ``Requests`` at first and after each loss, ``Stream`` on demand.

    The callbacks run in the thread of the connection: ``on_open`` with each new connection, ``on_reading`` with new
    values, and ``on_lost`` with the cause, as soon as a connection is lost or an attempt fails.
    """

    def __init__(
        self,
        address: str,
        rate: float,
        reconnect_period: float,
        on_open: Callable[[Source], None],
        on_reading: Callable[[Reading], None],
        on_lost: Callable[[Exception], None],
    ) -> None:
        self._reconnect_period = reconnect_period
        self._on_open, self._on_reading, self._on_lost = on_open, on_reading, on_lost
        self._changed = threading.Condition()
        self._source: Optional[Source] = None
        self._requests: Callable[[], Source] = lambda: Requests(address, rate)
        self._wanted = self._requests
        # The error of the last attempt, once it has an outcome.
        self._is_settled, self._error = False, None
        # An attempt runs, or follows without a pause.
        self._is_opening, self._is_closing = True, False
        self._thread = threading.Thread(target=self._run, name="wsg link", daemon=True)

    # Calls from other threads

    def start(self) -> None:
        """Begin to connect. Until then, a stop waits."""
        self._thread.start()

    def wait(self) -> None:
        """Wait for the outcome of the current attempt to connect, and raise its error."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._is_settled, OPENING):
                raise NotConnectedError("the gripper does not respond")
            if self._error is not None:
                raise self._error

    def stream(self, opener: Optional[Callable[[], Stream]]) -> None:
        """Replace the connection by a stream, or by a connection for requests (``None``), and wait for it."""
        self._want(opener or self._requests)
        try:
            self.wait()
            if opener is not None and not self.is_streaming:
                raise StreamEndedError("the stream has ended at once; the log has the reason")
        except GripperError:
            # No stream may open later.
            self._want(self._requests)
            raise

    def _want(self, wanted: Callable[[], Source]) -> None:
        with self._changed:
            if self._wanted is not wanted:
                self._wanted, self._is_settled = wanted, False
                self._changed.notify_all()

    @property
    def source(self) -> Source:
        """The current connection. Raises ``NotConnectedError``."""
        source = self._source
        if source is None:
            raise NotConnectedError(f"no connection: {self._error or 'connecting'}")
        return source

    @property
    def is_streaming(self) -> bool:
        return isinstance(self._source, Stream)

    def gripper(self) -> Gripper:
        """Return the driver for requests. Raises ``NotConnectedError``, and ``BusyError`` while set-points are streamed."""
        source = self.source
        if isinstance(source, Stream):
            raise BusyError("set-points are streamed: deactivate the node, or set the parameter mode to request")
        return source.gripper

    def halt(self, fast: bool) -> None:
        """Stop the fingers, or lock them by a FAST STOP. Raises ``NotConnectedError`` if there is no connection.

        While a connection opens, the fingers stand still, and the stop follows as soon as it is open.
        """
        source = self._next(None)
        try:
            source.halt(fast)
        except (StreamEndedError, NotConnectedError):
            # Another connection replaces this one, such as after the end of a stream.
            self._next(source).halt(fast)

    def _next(self, before: Optional[Source]) -> Source:
        """Return the connection that is open or opens after this one. Raises ``NotConnectedError``."""

        def is_known() -> bool:
            return self._source is not before if self._source else not self._is_opening

        with self._changed:
            self._changed.wait_for(lambda: self._is_closing or is_known(), OPENING)
            if self._source in (None, before):
                raise NotConnectedError(f"no connection: {self._error or 'connecting'}")
            return self._source

    def close(self) -> None:
        """Stop a running motion, announce the end of the connection, and end the thread."""
        with self._changed:
            self._is_closing = True
            self._changed.notify_all()
        self._thread.join(OPENING)

    # The thread

    def _run(self) -> None:
        while not self._is_closing:
            wanted, source = self._wanted, None
            try:
                self._is_opening = True
                source = wanted()
                self._settle(source, None, False)
                self._read(source, wanted)
                # Another connection is wanted.
                with self._changed:
                    self._source, self._is_opening = None, True
            except Exception as error:  # Also one of a callback: the thread must not end.
                # Nothing resumes by itself: the next connection is for requests.
                with self._changed:
                    if self._wanted is wanted:
                        self._wanted = self._requests
                self._settle(None, error, wanted is not self._requests)
                with suppress(Exception):
                    self._on_lost(error)
            if source is not None:
                source.close()
            if self._error is not None and wanted is self._requests:
                if self._reconnect_period == 0:
                    return
                self._pause(wanted, self._reconnect_period)

    def _settle(self, source: Optional[Source], error: Optional[Exception], is_opening: bool) -> None:
        with self._changed:
            self._source, self._error, self._is_settled, self._is_opening = source, error, True, is_opening
            self._changed.notify_all()

    def _is_over(self, wanted: object) -> bool:
        return self._is_closing or self._wanted is not wanted

    def _pause(self, wanted: object, seconds: float) -> None:
        """Wait. Return early at the end, and when another connection is wanted."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_over(wanted), seconds)

    def _read(self, source: Source, wanted: object) -> None:
        """Read the state until another connection is wanted. Raises the error that ends the connection."""
        if not self._is_closing:
            self._on_open(source)
        while not self._is_over(wanted):
            with suppress(StoppedError):  # A stop of this program ended the query, not the connection.
                reading = source.read()
                if not self._is_over(wanted):
                    self._on_reading(reading)
