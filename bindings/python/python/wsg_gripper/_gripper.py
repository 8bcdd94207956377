"""The blocking driver."""

from __future__ import annotations

from typing import Callable, Generic, Optional, TypeVar

from ._closing import Closing
from ._errors import UnsupportedError
from ._native import Driver
from ._native import Motion as _NativeMotion
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
    SystemFlags,
    SystemInfo,
)
from ._updates import Subscription, reading

T = TypeVar("T")
U = TypeVar("U")
Self = TypeVar("Self", bound="Gripper")


def grip_result(is_held: Optional[bool]) -> GripResult:
    return GripResult.HELD if is_held else GripResult.NO_PART


def nothing(_: object) -> None:
    return None


def soft_limits(limits: Optional[tuple[float, float]]) -> Optional[SoftLimits]:
    return None if limits is None else SoftLimits(*limits)


def require_gcl(core: Driver) -> Driver:
    if not core.is_gcl():
        raise UnsupportedError("only the text protocol (GCL) has this setting: use an address such as gcl://192.168.1.20")
    return core


class Motion(Generic[T]):
    """A motion in progress, returned by the methods ``begin_...`` of :class:`Gripper`.

    The fingers move on their own. Other requests are possible meanwhile. Dropping a ``Motion`` does not stop it.
    """

    def __init__(self, native: _NativeMotion, convert: Callable[[Optional[bool]], T]) -> None:
        self._native = native
        self._convert = convert

    def wait(self) -> T:
        """Wait for the end of the motion and return its result.

        Raises ``BlockedError``, ``AbortedError``, ``StoppedError`` or ``MotionError`` if it failed, and ``BusyError`` if
        another motion has begun since.
        """
        return self._convert(self._native.wait())

    def poll(self) -> Optional[tuple[T]]:
        """Return ``None`` while the motion continues, otherwise its result in a tuple. Raises like :meth:`wait`."""
        result = self._native.poll()
        return None if result is None else (self._convert(result[0]),)

    def done(self) -> bool:
        """Return whether the motion has ended. Raises like :meth:`wait`."""
        return self._native.poll() is not None


class Gripper(Closing):
    """A connection to a gripper. Each method waits for the reply.

    Addresses:

    - ``tcp://192.168.1.20`` (port 1000): binary protocol over TCP
    - ``udp://192.168.1.20`` (port 1500, replies to ``?answer=1501``): over UDP
    - ``serial:/dev/ttyUSB0?rate=115200``: over RS-232
    - ``slcan:/dev/ttyACM0?kbit=500&id=120``: over CAN through an SLCAN adapter, with the identifier in hex
    - ``socketcan:can0?id=120``: over CAN through an interface of Linux
    - ``gcl://192.168.1.20``, ``gcl+udp://192.168.1.20``: text protocol (GCL). ``?force=5..80&speed=5..420`` states the
      limits in N and mm/s, which the gripper does not report

    ::

        with Gripper("tcp://192.168.1.20") as gripper:
            gripper.home()
            if gripper.grip(20, speed=100, force=40):
                print(gripper.force(), "N")
            gripper.release(60, speed=200)

    Methods are thread-safe. While one thread waits in a motion, requests of other threads pass, and ``stop`` ends the
    motion. Ctrl-C stops the fingers and raises ``KeyboardInterrupt``.

    The end of a ``with`` block stops a running motion and announces the end of the connection. Without the
    announcement, a gripper on TCP enters FAST STOP (command set, 1.4.2). A deleted ``Gripper`` and the end of the
    interpreter announce it as well.

    Every request can raise ``NotConnectedError``, ``UnansweredError``, ``RefusedError``, and ``StoppedError`` if another
    thread calls ``stop``. Widths are in mm, speeds in mm/s, forces in N summed over both fingers.

    A value outside the :meth:`limits` of the gripper raises ``InvalidError`` before anything changes. Over the text
    protocol (GCL), the stroke follows from the model, and other limits are known only if the address states them.
    Without them, only negative speeds and forces are refused.
    """

    _core: Driver

    def __init__(self, address: str) -> None:
        """Connect to the gripper at this address, within 3 s.

        Raises ``InvalidError`` for an invalid address and ``NotConnectedError`` if there is no reply.
        """
        self._core = Driver(address)

    @classmethod
    def _over(cls: type[Self], core: Driver) -> Self:
        gripper = cls.__new__(cls)
        gripper._core = core
        return gripper

    @staticmethod
    def _then(value: T, convert: Callable[[T], U]) -> U:
        """Convert the result of a request. ``AsyncGripper`` awaits it first."""
        return convert(value)

    def close(self) -> None:
        """Stop a running motion, announce the end of the connection and close it (command set, 3.1.2)."""
        self._core.close()

    @property
    def is_open(self) -> bool:
        """Whether ``close`` has not been called."""
        return self._core.is_open()

    # Motions (command set, 3.2)

    def home(self, direction: HomingDirection = HomingDirection.DEFAULT) -> None:
        """Reference the fingers at an end stop, which takes up to about 4 s (command set, 3.2.1).

        Raises ``BlockedError`` if the fingers reach no end stop.
        """
        return self._then(self._core.home(direction, True), nothing)

    def move(self, width: float, speed: float, *, clamp: bool = False) -> None:
        """Move the fingers to an opening width in mm at a speed in mm/s (command set, 3.2.2).

        At an obstacle the motor is turned off. With ``clamp`` the fingers push with half of the nominal force and
        continue when the obstacle is gone. Raises ``BlockedError`` if an obstacle blocks the fingers.
        """
        return self._then(self._core.move_to(width, speed, clamp, True), nothing)

    def move_by(self, offset: float, speed: float, *, clamp: bool = False) -> None:
        """Open the fingers by an offset in mm, or close them by a negative one. Otherwise like :meth:`move`.

        The target must be inside the stroke.
        """
        return self._then(self._core.move_by(offset, speed, clamp, True), nothing)

    def grip(self, width: float, speed: float, force: Optional[float] = None) -> GripResult:
        """Grip a part of a nominal width in mm at a speed in mm/s (command set, 3.2.6).

        ``force`` sets the force limit in N first, see :meth:`set_force_limit`. The limit remains after the grip. If the
        gripper refuses the grip, the previous limit is set back. A missing part is a result, not an error:
        ``GripResult.NO_PART``, which is false.
        """
        return self._then(self._core.grip(width, speed, force, True), grip_result)

    def release(self, width: float, speed: float) -> None:
        """Open the fingers to a width in mm at a speed in mm/s, to release a part (command set, 3.2.7)."""
        return self._then(self._core.release(width, speed, True), nothing)

    def begin_home(self, direction: HomingDirection = HomingDirection.DEFAULT) -> Motion[None]:
        """Begin :meth:`home` and return when the gripper reports E_CMD_PENDING."""
        return Motion(self._core.home(direction, False), nothing)

    def begin_move(self, width: float, speed: float, *, clamp: bool = False) -> Motion[None]:
        """Begin :meth:`move` and return when the gripper reports E_CMD_PENDING."""
        return Motion(self._core.move_to(width, speed, clamp, False), nothing)

    def begin_move_by(self, offset: float, speed: float, *, clamp: bool = False) -> Motion[None]:
        """Begin :meth:`move_by` and return when the gripper reports E_CMD_PENDING."""
        return Motion(self._core.move_by(offset, speed, clamp, False), nothing)

    def begin_grip(self, width: float, speed: float, force: Optional[float] = None) -> Motion[GripResult]:
        """Begin :meth:`grip` and return when the gripper reports E_CMD_PENDING."""
        return Motion(self._core.grip(width, speed, force, False), grip_result)

    def begin_release(self, width: float, speed: float) -> Motion[None]:
        """Begin :meth:`release` and return when the gripper reports E_CMD_PENDING."""
        return Motion(self._core.release(width, speed, False), nothing)

    def stop(self) -> None:
        """Stop the fingers and release the force (command set, 3.2.3).

        It is sent at once, even while another thread waits in a motion, which then raises ``StoppedError``.
        """
        return self._core.stop(False)

    def fast_stop(self) -> None:
        """Stop the fingers as fast as possible and lock them until :meth:`acknowledge` (command set, 3.2.4).

        It is sent like :meth:`stop`, and repeated until the gripper confirms it.
        """
        return self._core.stop(True)

    def acknowledge(self) -> None:
        """Acknowledge a FAST STOP or a fault, which unlocks the fingers (command set, 3.2.5).

        No other method does so. Make sure that the fingers may move.
        """
        return self._core.acknowledge()

    # Settings (command set, 3.3)

    def acceleration(self) -> float:
        """Return the acceleration in mm/s² (command set, 3.3.2)."""
        return self._core.acceleration()

    def set_acceleration(self, acceleration: float) -> None:
        """Set the acceleration of subsequent motions in mm/s² (command set, 3.3.1).

        It is read back. Raises ``MismatchError`` if the values differ.
        """
        return self._core.set_acceleration(acceleration)

    def force_limit(self) -> float:
        """Return the force limit in N (command set, 3.3.4)."""
        return self._core.force_limit()

    def set_force_limit(self, force: float) -> None:
        """Set the maximum force of subsequent grips and moves in N (command set, 3.3.3).

        It is read back. Raises ``MismatchError`` if the values differ. Forces above the nominal one require
        :meth:`set_overdrive`.
        """
        return self._core.set_force_limit(force)

    def soft_limits(self) -> Optional[SoftLimits]:
        """Return the range of permitted opening widths in mm, or ``None`` if none is set (command set, 3.3.6)."""
        return self._then(self._core.soft_limits(), soft_limits)

    def set_soft_limits(self, minus: float, plus: float) -> None:
        """Permit opening widths from ``minus`` to ``plus`` in mm only (command set, 3.3.5).

        The gripper refuses motions to other widths: ``RefusedError`` with E_RANGE_ERROR.
        """
        return self._core.set_soft_limits(minus, plus)

    def clear_soft_limits(self) -> None:
        """Remove the soft limits (command set, 3.3.7)."""
        return self._core.clear_soft_limits()

    def set_overdrive(self, enabled: bool) -> None:
        """Allow or forbid forces up to the overdrive limit (command set, 3.3.8).

        If they are forbidden, the gripper reduces a force limit above the nominal force to the nominal force.
        """
        return self._core.set_overdrive(enabled)

    def tare(self) -> None:
        """Zero the force sensor (command set, 3.3.9).

        Raises ``RefusedError`` with E_NOT_AVAILABLE if there is no sensor, and with E_ACCESS_DENIED while a part is held.
        """
        return self._core.tare()

    def part_width_tolerance(self) -> float:
        """Return how far before the nominal width a grip may meet its part, in mm (GCL, 2.2.5). GCL only."""
        return require_gcl(self._core).part_width_tolerance(None)

    def set_part_width_tolerance(self, tolerance: float) -> float:
        """Set the part width tolerance in mm until the connection ends; return the accepted value. GCL only."""
        return require_gcl(self._core).part_width_tolerance(tolerance)

    def clamping_travel(self) -> float:
        """Return how far the fingers of a grip may travel to build up the force, in mm (GCL, 2.2.6). GCL only."""
        return require_gcl(self._core).clamping_travel(None)

    def set_clamping_travel(self, travel: float) -> float:
        """Set the clamping travel in mm until the connection ends; return the accepted value. GCL only."""
        return require_gcl(self._core).clamping_travel(travel)

    # State (command set, 3.4)

    def flags(self) -> SystemFlags:
        """Return the system state flags (command set, 3.4.1)."""
        return self._then(self._core.flags(), SystemFlags)

    def state(self) -> GripperState:
        """Return the state of the gripping process (command set, 3.4.2)."""
        return self._then(self._core.state(), GripperState)

    def statistics(self, reset: bool = False) -> Statistics:
        """Return the counts of grips, and restart them at 0 if ``reset`` is true (command set, 3.4.3)."""
        return self._then(self._core.statistics(reset), Statistics._make)

    def width(self) -> float:
        """Return the opening width in mm (command set, 3.4.4)."""
        return self._core.width()

    def speed(self) -> float:
        """Return the finger speed in mm/s (command set, 3.4.5)."""
        return self._core.speed()

    def force(self) -> float:
        """Return the gripping force in N (command set, 3.4.6)."""
        return self._core.force()

    def temperature(self) -> float:
        """Return the temperature of the device in °C (command set, 3.4.7)."""
        return self._core.temperature()

    def subscribe(
        self,
        interval: Optional[float] = None,
        *,
        width: bool = True,
        speed: bool = True,
        force: bool = True,
    ) -> Subscription[Reading]:
        """Make the gripper send its state on its own, and iterate over it: the fastest way to observe a motion.

        ::

            with gripper.subscribe() as readings:
                for reading in readings:
                    print(reading.width, reading.force, reading.state)

        A real gripper sends about 140 values a second, so the shortest ``interval``, which is the default, is 24 ms for all
        three values, 16 ms for two and 10 ms for one. The longest is 1 s. A slow loop gets the newest reading. Other requests are
        possible meanwhile, from another thread or in the loop. A connection has one subscription at a time (``BusyError``).

        The loop raises ``NotConnectedError`` when the connection is lost, and ``UnansweredError`` if no reading arrives for 1 s
        and ``interval``.
        """
        return Subscription(self._core.subscribe(interval, width, speed, force), reading)

    # Device (command set, 3.5)

    def info(self) -> SystemInfo:
        """Return device type, versions and serial number (command set, 3.5.1)."""
        return self._then(self._core.info(), SystemInfo._make)

    def limits(self) -> Limits:
        """Return the physical limits (command set, 3.5.4)."""
        return self._then(self._core.limits(), Limits._make)

    def tag(self) -> str:
        """Return the device tag, which is empty if none is set (command set, 3.5.3)."""
        return self._core.tag()

    def set_tag(self, tag: str) -> None:
        """Set the device tag, up to 64 printable ASCII characters (command set, 3.5.2)."""
        return self._core.set_tag(tag)

    # Fingers (command set, 3.6); ``finger`` is the port, 1 or 2

    def finger_info(self, finger: int) -> FingerInfo:
        """Return the electronics at a finger port (command set, 3.6.1 and 3.6.5)."""
        return self._then(self._core.finger_info(finger), FingerInfo._make)

    def finger_flags(self, finger: int) -> FingerFlags:
        """Return the state flags of a finger (command set, 3.6.2 and 3.6.6)."""
        return self._then(self._core.finger_flags(finger), FingerFlags)

    def set_finger_power(self, finger: int, enabled: bool) -> None:
        """Switch the supply of a finger on, which takes about 500 ms, or off (command set, 3.6.3 and 3.6.7)."""
        return self._core.set_finger_power(finger, enabled)

    def finger_data(self, finger: int) -> bytes:
        """Return one data frame of a finger (command set, 3.6.4 and 3.6.8). A WSG-FMF sends one float in N."""
        return self._core.finger_data(finger)

    # Connection (command set, 3.1)

    def loop_back(self, data: bytes) -> None:
        """Test the connection with up to 256 bytes, which the gripper must return (command set, 3.1.1).

        Raises ``MismatchError`` if it returns other bytes.
        """
        return self._core.loop_back(data)

    def raw(self, command: int, payload: bytes = b"") -> bytes:
        """Send a command that a script on the gripper serves, usually A0h to BFh; return its payload after the status.

        No other motion may run meanwhile, and the script must reply within 1 s. Raises ``RefusedError`` with
        E_CMD_UNKNOWN if no script serves the command. The parameters of a command of the manual are not checked against
        the limits, so the gripper may correct them.
        """
        return self._core.raw(command, payload)
