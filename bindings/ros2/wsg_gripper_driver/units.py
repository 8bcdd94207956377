"""Conversions between ROS and the gripper. No ROS.

ROS uses m, m/s and N of one finger, positive for both. The driver uses mm, mm/s and N of the opening, the sum of both fingers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Optional

from wsg_gripper import Limits, SystemFlags

FINGERS = 2
# Deviation in mm, mm/s and N by which a rounded value may exceed a limit.
TOLERANCE = 0.01

# Levels of diagnostic_msgs/DiagnosticStatus.
OK, WARN, ERROR, STALE = range(4)
# Reported flags, the worst first.
CONDITIONS = (
    (SystemFlags.FAST_STOP, ERROR, "FAST STOP: make sure that the fingers may move, then call ~/acknowledge"),
    (SystemFlags.TEMP_FAULT, ERROR, "over-temperature"),
    (SystemFlags.POWER_FAULT, ERROR, "supply voltage out of range"),
    (SystemFlags.CURR_FAULT, ERROR, "motor current too high"),
    (SystemFlags.FINGER_FAULT, ERROR, "finger fault"),
    (SystemFlags.SCRIPT_FAILURE, WARN, "a script on the gripper failed"),
    (SystemFlags.TEMP_WARNING, WARN, "high temperature"),
)
NOT_REFERENCED = "not referenced: call ~/home, before which joint_states are not published"


class Target(NamedTuple):
    """A goal in the units of the driver. ``None`` stands for a value that was not requested."""

    width: float
    speed: Optional[float]
    force: Optional[float]


def joint_names(prefix: str) -> list[str]:
    return [f"{prefix}wsg_finger_{finger}_joint" for finger in ("left", "right")]


def _common(what: str, values: Sequence[float], count: int) -> float:
    """Return the value for each finger, and 0 without values."""
    if len(values) not in (0, count):
        raise ValueError(f"there are {len(values)} values of {what}; expected {count}, one for each joint")
    if not all(map(math.isfinite, values)) or len(values) and max(values) - min(values) > 1e-6:
        raise ValueError(f"{what} is {list(values)}; expected finite and equal values, since the fingers move together")
    return values[0] if len(values) else 0.0


def target(
    names: Sequence[str],
    positions: Sequence[float],
    velocities: Sequence[float],
    efforts: Sequence[float],
    joints: Sequence[str],
    limits: Limits,
) -> Target:
    """Convert a command for one or both fingers. Raises ``ValueError`` with the reason for a refusal.

    A missing velocity or effort, and one of 0, is not requested.
    """
    unknown = set(names) - set(joints)
    if unknown:
        raise ValueError(f"joint {min(unknown)} is unknown; expected {' or '.join(joints)}")
    count = len(names) or 1
    if not len(positions):
        raise ValueError("there is no position")
    width = _common("position", positions, count) * FINGERS * 1000
    speed = abs(_common("velocity", velocities, count)) * FINGERS * 1000
    force = abs(_common("effort", efforts, count)) * FINGERS
    most_force = max(limits.nominal_force, limits.overdrive_force)
    for what, value, low, high, scale in (
        ("position in m", width, 0, limits.stroke, 1000),
        ("velocity in m/s", speed, limits.min_speed if speed else 0, limits.max_speed, 1000),
        ("effort in N", force, limits.min_force if force else 0, most_force, 1),
    ):
        if not low - TOLERANCE <= value <= high + TOLERANCE:
            value, low, high = (round(it / FINGERS / scale, 6) for it in (value, low, high))
            raise ValueError(f"{what} is {value}; expected {low} to {high} for each finger")
    return Target(min(max(width, 0.0), limits.stroke), speed or None, force or None)


def health(flags: SystemFlags) -> tuple[int, str]:
    """Return the level and the message of the diagnostics for the flags of a connected gripper."""
    found = [(level, text) for flag, level, text in CONDITIONS if flag in flags]
    if SystemFlags.REFERENCED not in flags:
        found.append((WARN, NOT_REFERENCED))
    level = max((level for level, _ in found), default=OK)
    return level, "; ".join(text for _, text in found) or "ready"


def description(error: Exception) -> str:
    """Describe an error in one line: its class, the status code of the gripper and the text."""
    status, text = getattr(error, "status", None), str(error)
    code = f" {status.name}" if status is not None and status.name not in text else ""
    return f"{type(error).__name__}{code}: {text}"
