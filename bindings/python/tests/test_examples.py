"""The examples run against the simulator."""

from __future__ import annotations

import importlib
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from wsg_gripper import StreamingGripper
from wsg_gripper.sim import Simulator

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


def test_lerobot_plugin_moves_the_gripper(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent / "standin"))
    monkeypatch.syspath_prepend(str(EXAMPLES / "lerobot_robot_wsg"))
    from lerobot.robots import RobotConfig

    plugin: Any = importlib.import_module("lerobot_robot_wsg")
    script = tmp_path / "wsg_stream.lua"
    script.write_text(StreamingGripper.SCRIPT)
    with Simulator(script=script, homing_speed=400, part=60) as simulator:
        simulator.wait_for_script()
        assert RobotConfig.choices == {"wsg": plugin.WsgConfig}
        robot = plugin.Wsg(plugin.WsgConfig(address=simulator.tcp, force=30))
        assert not robot.is_connected
        robot.connect()
        assert robot.is_connected
        assert robot.send_action({"gripper.pos": 50}) == {"gripper.pos": 50}
        end = time.monotonic() + 10
        while robot.get_observation()["gripper.force"] < 25:
            assert time.monotonic() < end
        observation = robot.get_observation()
        assert set(observation) == set(robot.observation_features)
        assert observation["gripper.pos"] == pytest.approx(60, abs=1)
        robot.disconnect()
        assert not robot.is_connected
