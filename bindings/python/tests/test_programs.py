"""The console scripts of the wheel."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from wsg_gripper import Gripper, StoppedError, SystemFlags
from wsg_gripper.sim import Simulator

WSG, WSG_SIM = (str(Path(sys.executable).parent / name) for name in ("wsg", "wsg-sim"))


@contextlib.contextmanager
def running(*command: str, stderr: int | None = None) -> Iterator[subprocess.Popen[str]]:
    """Run a program. A test that fails ends it, for which ``Popen`` alone would wait."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True) as program:
        try:
            yield program
        finally:
            program.kill()


def test_wsg_commands_a_gripper(wsg_sim: Simulator) -> None:
    home = subprocess.run([WSG, "gripper", wsg_sim.tcp, "home"], capture_output=True, text=True)
    assert home.returncode == 0, home.stderr
    width = subprocess.run([WSG, "gripper", wsg_sim.tcp, "width"], capture_output=True, text=True)
    assert width.stdout == "width 110.00 mm\n"
    refused = subprocess.run([WSG, "gripper", wsg_sim.tcp, "tare"], capture_output=True, text=True)
    assert refused.returncode not in (0, 1, 2), refused


def test_wsg_reports_a_wrong_command_line() -> None:
    wrong = subprocess.run([WSG, "gripper", "192.168.1.20"], capture_output=True, text=True)
    assert wrong.returncode == 2
    assert "tcp://HOST" in wrong.stderr


def test_wsg_sim_serves_a_gripper_until_ctrl_c() -> None:
    with running(WSG_SIM, "--tcp", "127.0.0.1:0", "--time-scale", "100") as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "model wsg50-110\n"
        line, address = program.stdout.readline().split()
        assert line == "tcp"
        gripper = [WSG, "gripper", f"tcp://{address}", "home"]
        assert subprocess.run(gripper).returncode == 0
        program.send_signal(signal.SIGINT)
        assert program.wait(timeout=10) == 0


@pytest.mark.parametrize(
    ("line", "place", "scheme"),
    [("--tcp", "127.0.0.1:0", "tcp://"), ("--serial", "pty", "serial:"), ("--slcan", "pty", "slcan:")],
)
def test_stop_of_another_thread_ends_a_grip(line: str, place: str, scheme: str) -> None:
    with running(WSG_SIM, line, place, "--homing-speed", "400") as program:
        assert program.stdout is not None
        program.stdout.readline()
        address = scheme + program.stdout.readline().split()[1]
        with Gripper(address) as gripper:
            gripper.home()
            raised: list[BaseException] = []

            def grip() -> None:
                with pytest.raises(StoppedError) as stopped:
                    gripper.grip(20, speed=5)
                raised.append(stopped.value)

            thread = threading.Thread(target=grip)
            thread.start()
            while SystemFlags.MOVING not in gripper.flags():
                assert thread.is_alive()
            gripper.stop()
            assert SystemFlags.MOVING not in gripper.flags()
            thread.join()
            assert raised and gripper.width() > 100
            gripper.move(100, speed=400)


def test_ctrl_c_stops_the_fingers_without_a_traceback(simulator: Simulator) -> None:
    assert subprocess.run([WSG, "gripper", simulator.tcp, "home"]).returncode == 0
    with running(WSG, "gripper", simulator.tcp, "move", "10", "5", stderr=subprocess.PIPE) as program:
        while SystemFlags.MOVING not in simulator.observe().flags:
            assert program.poll() is None
        program.send_signal(signal.SIGINT)
        assert program.stderr is not None
        assert "Traceback" not in program.stderr.read()
        assert program.wait(timeout=10) == 130
    assert SystemFlags.MOVING not in simulator.observe().flags
