"""Stand-ins for the modules that LeRobot's base classes import and do not need here: PyTorch, and those for Python 3.12."""

from __future__ import annotations

import faulthandler
import sys
import types
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "python/tests"))
from pauses import pytest_runtest_protocol  # noqa: E402, F401

faulthandler.dump_traceback_later(600, exit=True)

torch = types.ModuleType("torch")
for name in ("Tensor", "device", "dtype"):
    setattr(torch, name, type(name, (), {}))
sys.modules["torch"] = torch
if sys.version_info < (3, 12):
    motors = types.ModuleType("lerobot.motors")
    setattr(motors, "MotorCalibration", object)
    sys.modules["lerobot.motors"] = motors
