"""The examples run against the simulator."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"


@pytest.mark.parametrize(
    ("script", "expected"),
    [
        ("first_grip.py", "holds a part of"),
        ("force_while_holding.py", "PART_LOST"),
        ("streaming.py", "back-end: script"),
        ("umi_evaluation.py", "closed to 0.0"),
    ],
)
def test_example_prints_its_result(script: str, expected: str) -> None:
    done = subprocess.run([sys.executable, str(EXAMPLES / script)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert expected in done.stdout


def test_example_of_a_test_passes() -> None:
    pytest_run = [sys.executable, "-m", "pytest", "-q", str(EXAMPLES / "test_without_a_gripper.py")]
    done = subprocess.run(pytest_run, capture_output=True, text=True, timeout=60)
    assert "4 passed" in done.stdout, done.stdout + done.stderr
