"""States, status codes and results, with the units and names of the manual."""

from __future__ import annotations

import time
from enum import Enum, IntEnum, IntFlag
from typing import NamedTuple, Optional


class Status(IntEnum):
    """Status codes of replies (command set, appendix A)."""

    E_SUCCESS = 0
    E_NOT_AVAILABLE = 1
    E_NO_SENSOR = 2
    E_NOT_INITIALIZED = 3
    E_ALREADY_RUNNING = 4
    E_FEATURE_NOT_SUPPORTED = 5
    E_INCONSISTENT_DATA = 6
    E_TIMEOUT = 7
    E_READ_ERROR = 8
    E_WRITE_ERROR = 9
    E_INSUFFICIENT_RESOURCES = 10
    E_CHECKSUM_ERROR = 11
    E_NO_PARAM_EXPECTED = 12
    E_NOT_ENOUGH_PARAMS = 13
    E_CMD_UNKNOWN = 14
    E_CMD_FORMAT_ERROR = 15
    E_ACCESS_DENIED = 16
    E_ALREADY_OPEN = 17
    E_CMD_FAILED = 18
    E_CMD_ABORTED = 19
    E_INVALID_HANDLE = 20
    E_NOT_FOUND = 21
    E_NOT_OPEN = 22
    E_IO_ERROR = 23
    E_INVALID_PARAMETER = 24
    E_INDEX_OUT_OF_BOUNDS = 25
    E_CMD_PENDING = 26
    E_OVERRUN = 27
    E_RANGE_ERROR = 28
    E_AXIS_BLOCKED = 29
    E_FILE_EXISTS = 30

    @classmethod
    def _missing_(cls, value: object) -> Status | None:
        if not isinstance(value, int):
            return None
        unknown = int.__new__(cls, value)
        unknown._name_, unknown._value_ = f"E_{value}", value
        return unknown


class GripperState(IntEnum):
    """State of the gripping process (command set, 3.4.2 and appendix C)."""

    IDLE = 0
    GRIPPING = 1
    NO_PART = 2
    PART_LOST = 3
    HOLDING = 4
    RELEASING = 5
    POSITIONING = 6
    ERROR = 7


class HomingDirection(IntEnum):
    """End stop to which homing moves (command set, 3.2.1)."""

    DEFAULT = 0
    """The direction configured in the gripper."""
    OPEN = 1
    """Outward: the fingers open."""
    CLOSE = 2
    """Inward: the fingers close."""


class SystemFlags(IntFlag):
    """System state flags (command set, appendix B). Reserved bits are preserved."""

    REFERENCED = 1 << 0
    MOVING = 1 << 1
    BLOCKED_MINUS = 1 << 2
    BLOCKED_PLUS = 1 << 3
    SOFT_LIMIT_MINUS = 1 << 4
    SOFT_LIMIT_PLUS = 1 << 5
    AXIS_STOPPED = 1 << 6
    TARGET_POS_REACHED = 1 << 7
    OVERDRIVE_MODE = 1 << 8
    FORCECNTL_MODE = 1 << 9
    FAST_STOP = 1 << 12
    TEMP_WARNING = 1 << 13
    TEMP_FAULT = 1 << 14
    POWER_FAULT = 1 << 15
    CURR_FAULT = 1 << 16
    FINGER_FAULT = 1 << 17
    CMD_FAILURE = 1 << 18
    SCRIPT_RUNNING = 1 << 19
    SCRIPT_FAILURE = 1 << 20


class FingerFlags(IntFlag):
    """State flags of a finger (command set, 3.6.2)."""

    POWER_ON = 1 << 0
    CONFIG_AVAIL = 1 << 1
    COMM_OPEN = 1 << 2
    POWER_FAULT = 1 << 8
    COMM_FAULT = 1 << 9
    INIT_FAULT = 1 << 10


class GripResult(Enum):
    """Result of a grip (command set, 3.2.6). ``HELD`` is true and ``NO_PART`` is false."""

    HELD = "held"
    """A part is held with the gripping force."""
    NO_PART = "no part"
    """The fingers closed without finding a part or without building up the force."""

    def __bool__(self) -> bool:
        return self is GripResult.HELD


class Limits(NamedTuple):
    """Physical limits of a gripper (command set, 3.5.4). Forces are sums over both fingers."""

    stroke: float
    """Maximum opening width in mm."""
    min_speed: float
    """Minimum finger speed in mm/s."""
    max_speed: float
    """Maximum finger speed in mm/s."""
    min_acceleration: float
    """Minimum acceleration in mm/s²."""
    max_acceleration: float
    """Maximum acceleration in mm/s²."""
    min_force: float
    """Minimum gripping force in N."""
    nominal_force: float
    """Nominal gripping force in N, at a duty cycle of 100 %."""
    overdrive_force: float
    """Maximum gripping force in overdrive mode, in N."""


class SoftLimits(NamedTuple):
    """Permitted range of the opening width (command set, 3.3.5)."""

    minus: float
    """Minimum opening width in mm."""
    plus: float
    """Maximum opening width in mm."""


class Reading(NamedTuple):
    """One new value of each subscribed quantity, as ``subscribe`` yields it. No value is repeated from reading to reading."""

    received: float
    """Time at which the values arrived, as a value of ``time.time()`` in s."""
    width: Optional[float]
    """Opening width in mm; ``None`` without a subscription to it, and before homing."""
    speed: Optional[float]
    """Finger speed in mm/s, negative while the fingers close; ``None`` without a subscription to it."""
    force: Optional[float]
    """Gripping force in N, summed over both fingers; ``None`` without a subscription to it."""
    state: GripperState
    """Latest state of the gripping process."""
    flags: SystemFlags
    """Latest system state flags."""

    @property
    def age(self) -> float:
        """Time since the values arrived in s, now."""
        return time.time() - self.received


class SystemInfo(NamedTuple):
    """Device type, versions and serial number (command set, 3.5.1)."""

    device: str
    """Product type, such as ``WSG 50``."""
    hardware_revision: int
    firmware: str
    """Firmware version, such as ``2.6.4``."""
    serial_number: int


class Statistics(NamedTuple):
    """Counts of grips (command set, 3.4.3)."""

    total: int
    """All grips."""
    no_part: int
    """Grips that found no part."""
    part_lost: int
    """Grips whose part was lost before its release."""


class FingerInfo(NamedTuple):
    """Electronics at a finger port (command set, 3.6.1)."""

    kind: str
    """Kind of finger, such as ``WSG-FMF``."""
    data_len: int
    """Length of a data frame in bytes; 0 if the finger provides no data."""
