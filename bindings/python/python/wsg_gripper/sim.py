"""Virtual grippers, for tests and without hardware.

- :class:`VirtualGripper` runs in virtual time: no socket, no waiting, and the same result each time.
- :class:`Simulator` serves a gripper on sockets in real time, for any client: TCP, UDP, GCL, Modbus, and a page to watch it.

The pytest fixture ``wsg_sim`` is a :class:`Simulator`; it needs no import.

Options are the options of the program ``wsg-sim`` with underscores, such as ``model="wsg32"``, ``part=20``,
``soft_limits="10:90"``, ``time_scale=10``, ``force=40``, ``finger1="fmf"``, ``homing_at_start=True``. ``wsg-sim --help``
lists them.
"""

from __future__ import annotations

import time
from enum import Enum
from os import PathLike, fspath
from typing import NamedTuple, Optional, Union

from ._closing import Closing
from ._errors import RefusedError
from ._gripper import Gripper
from ._native import Rig, Server
from ._types import GripperState, Status, SystemFlags

__all__ = ["Fault", "Observation", "Simulator", "VirtualGripper"]

Option = Union[str, float, bool, "PathLike[str]"]

STIFFNESS = 100.0
"""Default stiffness of a part in N/mm."""


class Fault(Enum):
    """A fault of the gripper that a test injects."""

    AXIS_BLOCKED = "the fingers move in neither direction"
    OVER_TEMPERATURE = "SF_TEMP_FAULT; motion is refused until it ends"
    SUPPLY_OUT_OF_RANGE = "SF_POWER_FAULT; motion is refused until it ends"
    MOTOR_CURRENT = "SF_CURR_FAULT and a FAST STOP"
    FINGER1_SHORT_CIRCUIT = "the supply of finger 1 is shorted"
    FINGER2_SHORT_CIRCUIT = "the supply of finger 2 is shorted"
    FINGER1_COMMUNICATION = "finger 1 does not answer"
    FINGER2_COMMUNICATION = "finger 2 does not answer"


class Observation(NamedTuple):
    """State of a virtual gripper as an observer beside it sees it."""

    width: float
    """Real opening width in mm, referenced or not."""
    speed: float
    """Change of the opening width in mm/s, negative while the fingers close."""
    force: float
    """Force on the fingers in N, summed over both."""
    force_limit: float
    """Force limit in N, summed over both fingers."""
    state: GripperState
    flags: SystemFlags
    temperature: float
    """Temperature of the device in °C."""
    part: Optional[float]
    """Width of the part in mm, wherever it is."""
    part_is_between: bool
    """Whether the part is between the fingers, or around them."""


def _observation(
    seen: tuple[float, float, float, float, int, int, float, Optional[float], bool],
) -> Observation:
    width, speed, force, force_limit, state, flags, temperature, part, part_is_between = seen
    return Observation(
        width, speed, force, force_limit, GripperState(state), SystemFlags(flags), temperature, part, part_is_between
    )


def _words(options: dict[str, Option]) -> list[str]:
    """Convert options to words of the command line of ``wsg-sim``."""
    words = []
    for name, value in options.items():
        if name in ("help", "version"):
            raise TypeError(f"unexpected option {name!r}")
        if value is not False:
            words.append("--" + name.replace("_", "-"))
        if not isinstance(value, bool):
            words.append(value if isinstance(value, str) else str(fspath(value) if isinstance(value, PathLike) else value))
    return words


class VirtualGripper:
    """A gripper, its line and its clock in virtual time.

    Time passes only while a program waits for the gripper, so a minute of travel takes milliseconds::

        virtual = VirtualGripper(part=20)
        with virtual.connect() as gripper:
            gripper.home()
            assert gripper.grip(20, speed=100) is GripResult.HELD
            virtual.set_part(None)                  # the part slips out
            virtual.pass_time(0.1)
            assert gripper.state() is GripperState.PART_LOST

    ``line`` is ``"tcp"``, ``"serial"`` or ``"gcl"``. The options are listed at the top of the module.
    """

    def __init__(self, line: str = "tcp", **options: Option) -> None:
        """Create a gripper just powered up: not referenced, its fingers half open."""
        self._rig = Rig(line, _words(options))

    def connect(self) -> Gripper:
        """Connect a driver. Raises ``BusyError`` while another one is connected."""
        return Gripper._over(self._rig.connect())

    @property
    def time(self) -> float:
        """Virtual time in seconds."""
        return self._rig.time()

    def pass_time(self, seconds: float) -> None:
        """Let this time in seconds pass without a request, in steps of 1 ms."""
        self._rig.pass_ms(round(seconds * 1000))

    def observe(self) -> Observation:
        """Return the state of the gripper, at any time and without a request."""
        return _observation(self._rig.state())

    def set_part(
        self, width: Optional[float], stiffness: float = STIFFNESS, *, inner_width: Optional[float] = None
    ) -> None:
        """Place a part of a width in mm and a stiffness in N/mm between the fingers, or remove it (``None``).

        A part with an inner width in mm is hollow. It is also placed around fingers that are narrower than its hole, and
        then gripped from inside by opening them.

        If the fingers do not hold the part, it waits until they are wide enough open, or narrow enough for its hole.
        Removing a held part loses it. Raises ``InvalidError`` for numbers that no part can have.
        """
        self._rig.set_part(width, stiffness, inner_width)

    def set_fault(self, fault: Fault, on: bool = True) -> None:
        """Begin or end a fault."""
        self._rig.set_fault(fault.name, on)

    def restart(self) -> None:
        """Power-cycle the gripper, which loses reference and settings. A TCP connection closes."""
        self._rig.restart()

    def cut_line(self) -> None:
        """Lose all bytes in both directions until :meth:`restore_line`, as with a pulled serial cable."""
        self._rig.cut_line()

    def close_line(self) -> None:
        """Close the connection. Unannounced, as here, it leaves a gripper on TCP in FAST STOP (command set, 1.4.2)."""
        self._rig.close_line()

    def restore_line(self) -> None:
        """Restore a line that was cut."""
        self._rig.restore_line()

    def inject(self, data: bytes) -> None:
        """Send bytes to the driver that do not come from the gripper, such as noise."""
        self._rig.inject(data)


class Simulator(Closing):
    """A virtual gripper on sockets of this computer, served by a thread in real time.

    ::

        with Simulator(part=20) as simulator, Gripper(simulator.tcp) as gripper:
            gripper.home()
            assert gripper.grip(20, speed=100)

    Every line has a free port, unless an option such as ``tcp="127.0.0.1:1000"`` names one. The other options are listed at
    the top of the module. Closing it powers the gripper off.
    """

    tcp: str
    """Address of the binary protocol over TCP, for ``Gripper``."""
    udp: str
    """Address of the binary protocol over UDP, for ``Gripper``."""
    gcl: str
    """Address of the text protocol over TCP, for ``Gripper``."""
    gcl_udp: str
    """Address of the text protocol over UDP, for ``Gripper``."""
    modbus: tuple[str, int]
    """Host and port of Modbus/TCP."""
    page: str
    """URL of a page that shows and controls the gripper; also the control interface, JSON over HTTP."""

    def __init__(self, **options: Option) -> None:
        """Open the lines and power up the gripper."""
        self._server = Server(_words(options))
        (tcp, udp, gcl, gcl_udp, modbus, control), answers = self._server.addresses()
        self.tcp = f"tcp://{tcp}"
        self.udp = f"udp://{udp}?answer={answers}"
        self.gcl = f"gcl://{gcl}"
        self.gcl_udp = f"gcl+udp://{gcl_udp}"
        self.page = f"http://{control}/"
        host, _, port = (modbus or "").rpartition(":")
        self.modbus = host, int(port)

    def close(self) -> None:
        """Power the gripper off and close its lines."""
        self._server.close()

    def observe(self) -> Observation:
        """Return the state of the gripper, without a request."""
        return _observation(self._server.state())

    def set_part(
        self, width: Optional[float], stiffness: float = STIFFNESS, *, inner_width: Optional[float] = None
    ) -> None:
        """Place a part between the fingers or remove it; see :meth:`VirtualGripper.set_part`."""
        self._server.set_part(width, stiffness, inner_width)

    def set_fault(self, fault: Fault, on: bool = True) -> None:
        """Begin or end a fault."""
        self._server.set_fault(fault.name, on)

    def wait_for_script(self, command: int = 0xA5, seconds: float = 10) -> None:
        """Wait until the script of the option ``script`` serves a command, by default the one for streaming.

        Raises ``RefusedError`` after the time-out, for example if the script has failed.
        """
        end = time.monotonic() + seconds
        with Gripper(self.tcp) as gripper:
            while True:
                try:
                    gripper.raw(command, b"\0")
                    return
                except RefusedError as refused:
                    if refused.status is not Status.E_CMD_UNKNOWN or time.monotonic() > end:
                        raise
                time.sleep(0.01)
