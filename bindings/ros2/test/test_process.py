"""The program: signals, a kill, and a gripper that freezes."""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Callable

import pytest
from conftest import BOUND, Client, is_moving, stamp_of, wait_for, wait_until
from wsg_gripper import SystemFlags
from wsg_gripper.sim import Simulator

Start = Callable[..., "tuple[subprocess.Popen[str], Client]"]


@pytest.fixture
def start(client_node: Any) -> Iterator[Start]:
    """A function that starts the program with parameters."""
    programs = []

    def start(**parameters: Any) -> tuple[subprocess.Popen[str], Client]:
        name = f"p{random.randrange(1 << 30)}"
        words = ["--ros-args", "-r", f"__ns:=/{name}", "-r", "__node:=gripper"]
        words += [word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")]
        command = [Path(sys.executable).with_name("wsg_gripper"), *words]
        program = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        programs.append(program)
        return program, Client(client_node, name)

    yield start
    for program in programs:
        program.kill()
        program.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_stops_the_fingers_and_aborts_the_goal(start: Start, simulator: Simulator, number: signal.Signals) -> None:
    pytest.importorskip("control_msgs.action")
    from test_action import GoalStatus, Goals

    program, client = start(address=simulator.tcp, home_on_activate=True)
    client.wait_until_active()
    goals = Goals(client)
    handle = wait_until(lambda: (it := goals.send([0.0], [0.01])).accepted and it)
    result = handle.get_result_async()
    wait_until(lambda: is_moving(simulator))
    program.send_signal(number)
    output, _ = program.communicate(timeout=60)
    assert (program.returncode, "Traceback" in output) == (0, False), output
    assert f"Halted: {number.name} was received" in output
    assert wait_for(result).status == GoalStatus.STATUS_ABORTED
    flags = simulator.observe().flags
    assert not flags & (SystemFlags.FAST_STOP | SystemFlags.MOVING), "stopped and announced"
    assert simulator.observe().width > 50


@pytest.mark.parametrize("parameters", [{}, {"address": "tcp://127.0.0.1:1"}, {"address": "tcp://192.0.2.1"}])
def test_signal_ends_a_program_without_a_gripper(start: Start, parameters: dict[str, str]) -> None:
    program, client = start(**parameters)
    client.wait_for_state("NO_CONNECTION")
    program.send_signal(signal.SIGINT)
    output, _ = program.communicate(timeout=60)
    assert (program.returncode, "Traceback" in output) == (0, False), output


def test_wrong_parameter_is_an_error_in_one_line(start: Start) -> None:
    program, _ = start(speed=0.9)
    output, _ = program.communicate(timeout=60)
    assert (program.returncode, output.startswith("error: "), output.count("\n")) == (1, True, 1), output


def test_next_start_after_a_kill_says_how_to_continue(start: Start, simulator: Simulator) -> None:
    program, client = start(address=simulator.tcp, home_on_activate=True)
    client.wait_until_active()
    program.kill()
    wait_until(lambda: SystemFlags.FAST_STOP in simulator.observe().flags)
    program, client = start(address=simulator.tcp, home_on_activate=True)
    assert client.wait_for_health("then call ~/acknowledge").level == b"\2"
    wait_until(lambda: client.lifecycle() == "active")
    assert "E_ACCESS_DENIED" in client.call("release")[1]
    client.ok("acknowledge")
    client.ok("release")


def test_second_implementation_reads_joint_states_and_calls_a_service(start: Start, simulator: Simulator) -> None:
    program = Path(sys.prefix).parent / "second-client/debug/second-client"
    _, client = start(address=simulator.tcp, home_on_activate=True)

    def is_held() -> bool:
        command = [program, os.environ["ROS_DOMAIN_ID"], f"/{client.name}", "grip"]
        lines = subprocess.run(command, stdout=subprocess.PIPE, text=True, timeout=BOUND, check=True).stdout.splitlines()
        assert len(lines) == 4
        for stamp, rest in (line.split(maxsplit=1) for line in lines[:3]):
            assert time.time() - int(stamp) / 1e9 < BOUND
            assert re.fullmatch(r'\["wsg_finger_left_joint", "wsg_finger_right_joint"\] \[(0\.\d+), \1\]', rest), rest
        return lines[3] == "true HOLDING"

    wait_until(is_held)
    assert simulator.observe().force == pytest.approx(40, abs=1)


def test_requests_from_before_a_pause_are_refused(start: Start, simulator: Simulator) -> None:
    program, client = start(address=simulator.tcp, home_on_activate=True, speed=0.4)
    client.wait_until_active()
    for service in ("fast_stop", "acknowledge", "grip", "release"):
        client.ok(service)
    program.send_signal(signal.SIGSTOP)
    begin = time.monotonic()
    stop, *others = [client.begin(it) for it in ("fast_stop", "acknowledge", "grip")]
    wait_until(lambda: time.monotonic() - begin > 1.5)
    program.send_signal(signal.SIGCONT)
    answers = [wait_for(it).message for it in others]
    assert all("the request may be old" in it for it in answers), answers
    assert wait_for(stop).success and SystemFlags.FAST_STOP in simulator.observe().flags
    assert simulator.observe().width == pytest.approx(110, abs=0.1)
    wait_until(lambda: client.call("acknowledge")[0])


@pytest.mark.parametrize("mode", ["request", "stream"])
def test_frozen_gripper_is_reported_within_1_s(start: Start, mode: str) -> None:
    command = [Path(sys.executable).with_name("wsg-sim"), "--tcp", "127.0.0.1:0", "--homing-speed", "400"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as simulator:
        assert simulator.stdout is not None
        lines = iter(simulator.stdout.readline, "")
        address = next(line.split()[1] for line in lines if line.startswith("tcp "))
        _, client = start(address=f"tcp://{address}", mode=mode, home_on_activate=True)
        client.wait_until_active()
        delays, stamps = [], []
        for _ in range(3):
            if mode == "stream":
                client.ok("acknowledge")
                assert client.change("deactivate") and client.change("activate")
                client.wait_for_state("STREAMING")
            simulator.send_signal(signal.SIGSTOP)
            begin, stopped = time.monotonic(), time.time()
            client.wait_for_state("NO_CONNECTION")
            delays.append(time.monotonic() - begin)
            wait_until(lambda: client.health[-1].level == b"\3")
            stamps.append(stamp_of(client.joint_states[-1]) - stopped)
            count = len(client.joint_states)
            simulator.send_signal(signal.SIGCONT)
            begin = time.monotonic()
            wait_until(lambda: client.state() != "NO_CONNECTION")
            delays.append(time.monotonic() - begin)
            wait_until(lambda: len(client.joint_states) > count)
        simulator.kill()
    assert min(delays[::2]) < 1 and min(delays[1::2]) < 2, "reported, connected again"
    assert min(stamps) < 0.2, "no old value as current"
