"""Units, joints and diagnostics: conversions between ROS and the gripper. No ROS.

ROS uses m, m/s and N of one finger; both are positive. The driver uses mm, mm/s and N of the opening, the sum of both fingers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Optional

from wsg_gripper import GripperError, Limits, SystemFlags

FINGERS = ("left", "right")
PER_FINGER = 2
TOLERANCE = 0.01
"""Deviation in mm by which a rounded position may exceed the stroke."""

OK, WARN, ERROR, STALE = range(4)
"""Levels of diagnostic_msgs/DiagnosticStatus."""

CONDITIONS = (
    (SystemFlags.FAST_STOP, ERROR, "FAST STOP: make sure that the fingers may move, then call ~/acknowledge"),
    (SystemFlags.TEMP_FAULT, ERROR, "over-temperature"),
    (SystemFlags.POWER_FAULT, ERROR, "supply voltage out of range"),
    (SystemFlags.CURR_FAULT, ERROR, "motor current too high"),
    (SystemFlags.FINGER_FAULT, ERROR, "finger fault"),
    (SystemFlags.SCRIPT_FAILURE, WARN, "a script on the gripper failed"),
    (SystemFlags.TEMP_WARNING, WARN, "high temperature"),
)
"""Flags that are reported, with their levels, the worst first."""
NOT_REFERENCED = "not referenced: call ~/home; joint_states have no values before"


class Target(NamedTuple):
    """A goal in the units of the driver."""

    width: float
    speed: Optional[float]
    """``None``: the parameter."""
    force: Optional[float]
    """``None``: move without gripping."""


def joint_names(prefix: str) -> list[str]:
    return [f"{prefix}wsg_finger_{finger}_joint" for finger in FINGERS]


def target(
    names: Sequence[str],
    positions: Sequence[float],
    velocities: Sequence[float],
    efforts: Sequence[float],
    joints: Sequence[str],
    limits: Limits,
) -> Target:
    """Convert a command for one or both fingers. Raises ``ValueError`` with the reason for a refusal.

    A velocity or effort that is missing or 0 is not requested.
    """
    unknown = set(names) - set(joints)
    if unknown:
        raise ValueError(f"joint {min(unknown)} is unknown; expected {' or '.join(joints)}")
    count = len(names) or 1
    for what, values, is_optional in (
        ("position", positions, False),
        ("velocity", velocities, True),
        ("effort", efforts, True),
    ):
        if len(values) != count and not (is_optional and not values):
            raise ValueError(f"there are {len(values)} values of {what}; expected {count}, one for each joint")
        if not all(math.isfinite(value) for value in values):
            raise ValueError(f"a {what} is not finite")
        if values and max(values) - min(values) > 1e-6:
            raise ValueError(f"the fingers have different values of {what}; they move together")
    width = PER_FINGER * 1000 * positions[0]
    if not -TOLERANCE <= width <= limits.stroke + TOLERANCE:
        most = limits.stroke / PER_FINGER / 1000
        raise ValueError(f"position is {positions[0]} m; expected 0 to {most} m, the distance of one finger from the centre")
    speed = PER_FINGER * 1000 * abs(velocities[0]) if velocities else 0
    force = PER_FINGER * abs(efforts[0]) if efforts else 0
    most_force = max(limits.nominal_force, limits.overdrive_force)
    for what, value, low, high, unit in (
        ("velocity", speed, limits.min_speed, limits.max_speed, 1000),
        ("effort", force, limits.min_force, most_force, 1),
    ):
        if value and not low - TOLERANCE <= value <= high + TOLERANCE:
            shown = [number / PER_FINGER / unit for number in (value, low, high)]
            raise ValueError(f"{what} is {shown[0]}; expected {shown[1]} to {shown[2]} for each finger")
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
    status = error.status if isinstance(error, GripperError) else None
    text = str(error)
    code = f" {status.name}" if status is not None and status.name not in text else ""
    return f"{type(error).__name__}{code}: {text}"
