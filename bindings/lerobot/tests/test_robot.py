"""The plugin with LeRobot's own classes, against the simulator."""

from __future__ import annotations

import importlib
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import draccus
import pytest
from lerobot.robots import Robot, RobotConfig, make_robot_from_config
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from lerobot.utils.import_utils import register_third_party_plugins
from wsg_gripper import Gripper, HomingDirection, InvalidError, StreamingGripper, SystemFlags
from wsg_gripper.sim import Simulator

PLUGIN = Path(__file__).parent.parent


@dataclass
class Record:
    """The part of the configuration of ``lerobot-record`` that selects the robot."""

    robot: RobotConfig


@pytest.fixture
def simulator(tmp_path: Path) -> Iterator[Simulator]:
    """A gripper on which the script runs, not referenced."""
    script = tmp_path / "wsg_stream.lua"
    script.write_text(StreamingGripper.SCRIPT)
    with Simulator(script=script, homing_speed=400, part=60) as simulator:
        simulator.wait_for_script()
        yield simulator


def robot(tmp_path: Path, *options: str) -> Robot:
    """Make a robot from options of the command line, as the programs of LeRobot do."""
    register_third_party_plugins()
    words = ["--robot.type=wsg", f"--robot.calibration_dir={tmp_path}", *(f"--robot.{option}" for option in options)]
    return make_robot_from_config(draccus.parse(Record, args=words).robot)


def wait_for(condition: Callable[[], Any]) -> None:
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end, "time-out"
        time.sleep(0.002)


def test_only_a_request_by_name_moves_the_fingers(simulator: Simulator, tmp_path: Path) -> None:
    gripper = robot(tmp_path, f"address={simulator.tcp}")
    assert not gripper.is_connected
    before = simulator.observe().width
    with pytest.raises(RuntimeError, match="not referenced"):
        gripper.connect()
    assert not gripper.is_connected
    gripper.connect(calibrate=False)
    assert gripper.is_connected and not gripper.is_calibrated
    for use in (gripper.get_observation, lambda: gripper.send_action({"gripper.pos": 50.0})):
        with pytest.raises(RuntimeError, match="not referenced"):
            use()
    assert simulator.observe().width == before
    gripper.calibrate()
    assert gripper.is_calibrated and simulator.observe().width != before
    gripper.disconnect()
    gripper.connect()
    gripper.disconnect()


def test_robot_grips_reports_its_force_and_refuses_wrong_widths(simulator: Simulator, tmp_path: Path) -> None:
    options = ["home_on_connect=true", "homing_direction=OPEN", "force=30"]
    gripper = robot(tmp_path, f"address={simulator.tcp}", *options)
    assert gripper.config.homing_direction is HomingDirection.OPEN
    gripper.connect()
    with pytest.raises(DeviceAlreadyConnectedError):
        gripper.connect()
    assert gripper.get_observation()["gripper.pos"] == pytest.approx(110, abs=1)
    action = {"gripper.pos": 50, "other.pos": 3.0}
    assert gripper.send_action(action) == {"gripper.pos": 50}
    for width in (-0.1, 110.1, float("nan")):
        with pytest.raises(InvalidError):
            gripper.send_action({"gripper.pos": width})
    wait_for(lambda: gripper.get_observation()["gripper.force"] > 25)
    observation = gripper.get_observation()
    assert set(observation) == set(gripper.observation_features)
    assert observation["gripper.pos"] == pytest.approx(60, abs=1)
    gripper.disconnect()
    wait_for(lambda: simulator.observe().force == 0)
    for use in (gripper.get_observation, lambda: gripper.send_action(action), gripper.calibrate):
        with pytest.raises(DeviceNotConnectedError):
            use()
    gripper.disconnect()


def test_fast_stop_ends_the_stream_and_is_not_acknowledged(simulator: Simulator, tmp_path: Path) -> None:
    gripper = robot(tmp_path, f"address={simulator.tcp}", "home_on_connect=true")
    gripper.connect()
    with Gripper(simulator.udp) as other:
        other.fast_stop()
        wait_for(lambda: not gripper.is_connected)
        for use in (gripper.get_observation, lambda: gripper.send_action({"gripper.pos": 50}), gripper.calibrate):
            with pytest.raises(DeviceNotConnectedError, match="FAST STOP"):
                use()
        with pytest.raises(DeviceNotConnectedError, match="FAST STOP"):
            gripper.connect()
        assert SystemFlags.FAST_STOP in other.flags()
        other.acknowledge()
    gripper.connect()
    gripper.disconnect()


def test_no_old_observation_is_returned(tmp_path: Path) -> None:
    program = "from wsg_gripper.sim import Simulator as S; s = S(homing_speed=400); print(s.tcp, flush=True); input()"
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", program], text=True, stdin=pipe, stdout=pipe) as simulator:
        assert simulator.stdout is not None
        address = simulator.stdout.readline().strip()
        with Gripper(address) as gripper:
            gripper.home()
        plugin = robot(tmp_path, f"address={address}")
        plugin.connect()
        os.kill(simulator.pid, signal.SIGSTOP)
        begin = time.monotonic()
        wait_for(lambda: time.monotonic() - begin > 0.15)
        resumed = threading.Event()

        def resume() -> None:
            resumed.set()
            os.kill(simulator.pid, signal.SIGCONT)

        timer = threading.Timer(0.2, resume)
        timer.start()
        try:
            plugin.get_observation()
        except DeviceNotConnectedError:
            pass  # The computer paused, too.
        assert resumed.is_set()
        timer.join()
        simulator.kill()
        wait_for(lambda: not plugin.is_connected)
        with pytest.raises(DeviceNotConnectedError):
            plugin.get_observation()
        plugin.disconnect()


def test_mypy_accepts_plugin_and_tests() -> None:
    mypy = [sys.executable, "-m", "mypy", "--no-error-summary", "lerobot_robot_wsg", "tests"]
    done = subprocess.run(mypy, capture_output=True, text=True, cwd=PLUGIN)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[Path, str], Any]:
    """Return a function that runs the program of a page about the plugin as a module."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def run(page: Path, module: str) -> Any:
        blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
        [program] = [block for block in blocks if "lerobot_robot_wsg" in block]
        (tmp_path / f"{module}.py").write_text(program)
        return importlib.import_module(module)

    return run


def test_program_of_the_book_prints_an_observation(
    run: Callable[[Path, str], Any], capsys: pytest.CaptureFixture[str]
) -> None:
    run(PLUGIN.parents[1] / "docs" / "lerobot.md", "first")
    assert re.fullmatch(r"\{'gripper\.pos': (29|30)\.\d+, 'gripper\.vel': .*\}\n", capsys.readouterr().out)


def test_gripper_is_a_part_of_the_robot_of_the_readme(
    run: Callable[[Path, str], Any], simulator: Simulator, tmp_path: Path
) -> None:
    module = run(PLUGIN / "README.md", "my_arm")
    options = [f"gripper.address={simulator.tcp}", "gripper.home_on_connect=true", f"calibration_dir={tmp_path}"]
    words = ["--robot.type=my_arm", *(f"--robot.{option}" for option in options)]
    with module.MyArm(draccus.parse(Record, args=words).robot) as arm:
        action = {"joint.pos": 0.5, "left_gripper.pos": 70.0}
        assert arm.send_action(action) == action
        assert set(arm.action_features) == set(action)
        wait_for(lambda: arm.get_observation()["left_gripper.pos"] < 71)
        assert set(arm.get_observation()) == set(arm.observation_features)
        with pytest.raises(ValueError):
            arm.send_action({"joint.pos": 0.7, "left_gripper.pos": 200.0})
        assert arm.get_observation()["joint.pos"] == 0.5
    assert not arm.is_connected
