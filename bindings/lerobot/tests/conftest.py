"""Stand-ins for the modules that LeRobot's base classes import and do not need here: PyTorch, and those for Python 3.12."""

from __future__ import annotations

import faulthandler
import re
import sys
import types

import pytest
from _pytest.runner import runtestprotocol

faulthandler.dump_traceback_later(600, exit=True)

torch = types.ModuleType("torch")
for name in ("Tensor", "device", "dtype"):
    setattr(torch, name, type(name, (), {}))
sys.modules["torch"] = torch
if sys.version_info < (3, 12):
    motors = types.ModuleType("lerobot.motors")
    setattr(motors, "MotorCalibration", object)
    sys.modules["lerobot.motors"] = motors

PAUSE = re.compile("for more than 1 s|no answer")
"""What a stream or a request reports if the computer pauses for longer than they tolerate."""


def pytest_runtest_protocol(item: pytest.Function, nextitem: pytest.Item | None) -> bool:
    """Repeat a test in which the computer paused, with new fixtures."""
    for _ in range(8):
        reports = runtestprotocol(item, nextitem=nextitem, log=False)
        if not any(report.failed and PAUSE.search(report.longreprtext) for report in reports):
            break
        item._initrequest()
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    return True
