"""The node with a simulator and a client in one process."""

from __future__ import annotations

import socket
import time
from typing import Any, Callable

import pytest
from conftest import Client, is_moving, stamp_of, wait_for, wait_until
from wsg_gripper import Gripper, SystemFlags
from wsg_gripper.sim import Simulator

SERVICES = ("home", "stop", "fast_stop", "acknowledge", "grip", "release", "tare")


def unused_address() -> str:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return "127.0.0.1:%d" % server.getsockname()[1]


def test_services_exist_and_refuse_before_the_connection(grippers: Callable[..., Client]) -> None:
    client = grippers()
    wait_until(lambda: client.lifecycle() == "unconfigured")
    for service in SERVICES:
        success, message = client.call(service)
        assert not success and ("not configured" in message or "not active" in message), service
    assert client.wait_for_health("not configured").level == b"\3"
    assert not client.change("configure"), "without an address"
    assert client.state() == "NO_CONNECTION"


def test_grip_cycle_with_joint_states_per_finger(gripper: Client, simulator: Simulator) -> None:
    assert gripper.ok("grip") == "HOLDING"
    gripper.wait_for_state("HOLDING")
    assert simulator.observe().force == pytest.approx(40, abs=1)
    wait_until(lambda: abs(gripper.joint_states[-1].effort[0] - 20) < 0.5)
    held = gripper.joint_states[-1]
    assert held.name == ["wsg_finger_left_joint", "wsg_finger_right_joint"]
    assert list(held.position) == pytest.approx([0.0098] * 2, abs=3e-4)
    gripper.ok("release")
    assert simulator.observe().width == pytest.approx(110, abs=0.1)
    assert any(it.velocity[0] < -0.02 for it in gripper.joint_states), "closing"
    assert any(it.velocity[1] > 0.02 for it in gripper.joint_states), "opening"
    stamps = [stamp_of(it) for it in gripper.joint_states]
    assert stamps == sorted(set(stamps)), "each measurement once"
    simulator.set_part(None)
    assert gripper.call("grip") == (False, "NoPart: NO_PART: the fingers met no part")
    assert gripper.call("tare") == (False, "RefusedError: refused: E_NOT_AVAILABLE"), "without a sensor"


def test_start_moves_and_acknowledges_nothing(grippers: Callable[..., Client], simulator: Simulator) -> None:
    with Gripper(simulator.tcp) as other:
        other.fast_stop()
    before = simulator.observe()
    client = grippers(address=simulator.tcp, home_on_activate=True)
    assert client.wait_for_health("~/acknowledge").level == b"\2"
    assert "not referenced" in client.health[-1].message
    wait_until(lambda: client.lifecycle() == "inactive")
    assert not client.change("activate"), "home_on_activate does not acknowledge"
    assert client.call("home")[1].startswith("GripperError: the node is not active")
    after = simulator.observe()
    assert (after.width, SystemFlags.FAST_STOP in after.flags) == (before.width, True)
    assert client.joint_states == [], "without a reference, positions have no meaning"
    client.ok("acknowledge")
    assert client.change("activate")
    client.wait_until_active()
    assert simulator.observe().width == pytest.approx(110, abs=0.1), "homed as the parameter requests"


@pytest.mark.parametrize(
    ("mode", "rate", "least", "most"), [("request", 100.0, 34, 60), ("request", 10.0, 8, 14), ("stream", 20.0, 17, 24)]
)
def test_joint_states_come_at_the_rate_that_a_real_gripper_allows(
    grippers: Callable[..., Client], mode: str, rate: float, least: float, most: float
) -> None:
    with Simulator(profile="real", homing_speed=400) as simulator:
        client = grippers(address=simulator.tcp, mode=mode, joint_state_rate=rate, home_on_activate=True)

        def is_near() -> bool:
            stamps = [stamp_of(it) for it in client.joint_states[-20:]]
            per_second = len(stamps) > 19 and 19 / (stamps[-1] - stamps[0])
            assert per_second < most, "each message has three new values"
            return per_second > least

        wait_until(is_near)


@pytest.mark.parametrize("service", ["stop", "fast_stop"])
def test_stop_acts_within_250_ms_while_services_wait(gripper: Client, simulator: Simulator, service: str) -> None:
    delays = []
    for _ in range(3):
        if service == "fast_stop":
            gripper.ok("acknowledge")
        gripper.ok("release")
        gripper.set("speed", 0.02)
        grip = gripper.begin("grip")
        wait_until(lambda: is_moving(simulator))
        refused = [gripper.begin(it) for it in ("home", "release", "grip") * 5]
        assert all(wait_for(it).message == "BusyError: another motion is running" for it in refused)
        load = [gripper.begin("tare") for _ in range(8)]
        begin = time.monotonic()
        stop = gripper.begin(service)
        wait_until(lambda: not is_moving(simulator))
        delays.append(time.monotonic() - begin)
        assert wait_for(stop).success
        assert wait_for(grip).message == f"Halted: stopped by ~/{service}"
        assert not any(wait_for(it).success for it in load)
        gripper.set("speed", 0.4)
        if service == "fast_stop":
            assert "E_ACCESS_DENIED" in gripper.call("home")[1]
            assert gripper.wait_for_health("FAST STOP").level == b"\2"
    assert min(delays) < 0.25, delays


def test_parameters_outside_their_ranges_are_refused(gripper: Client, simulator: Simulator) -> None:
    for name, value in (("speed", 0.6), ("speed", float("nan")), ("force", 0.0), ("prefix", "a_"), ("mode", "stream")):
        assert not gripper.set(name, value).successful, name
    gripper.set("force", 500.0)
    assert gripper.call("grip")[1].startswith("InvalidError")
    assert not is_moving(simulator) and simulator.observe().force_limit == 40


def test_killed_gripper_is_reported_and_found_again(grippers: Callable[..., Client]) -> None:
    line = unused_address()
    simulator = Simulator(tcp=line, homing_speed=400)
    client = grippers(address=f"tcp://{line}", home_on_activate=True)
    client.wait_until_active()
    reported, returned = [], []
    for _ in range(3):
        begin = time.monotonic()
        simulator.close()
        client.wait_for_state("NO_CONNECTION")
        reported.append(time.monotonic() - begin)
        count = len(client.joint_states)
        assert client.wait_for_health("NotConnectedError").level == b"\3"
        assert "no connection" in client.call("home")[1] and "no connection" in client.call("fast_stop")[1]
        begin = time.monotonic()
        simulator = Simulator(tcp=line, homing_speed=400)
        client.wait_for_state("IDLE")
        returned.append(time.monotonic() - begin)
        assert client.wait_for_health("not referenced").level == b"\1"
        assert "E_NOT_INITIALIZED" in client.call("release")[1]
        assert simulator.observe().speed == 0, "no motion after a reconnect"
        assert len(client.joint_states) == count, "no position without a reference"
        client.ok("home")
        wait_until(lambda: len(client.joint_states) > count)
    simulator.close()
    assert min(reported) < 0.2 and min(returned) < 2, (reported, returned)


def test_deactivation_keeps_a_part(gripper: Client, simulator: Simulator) -> None:
    gripper.ok("grip")
    assert gripper.change("deactivate") and gripper.change("cleanup")
    assert simulator.observe().force == pytest.approx(40, abs=1)
    gripper.wait_for_state("NO_CONNECTION")
    assert SystemFlags.FAST_STOP not in simulator.observe().flags, "the end was announced"
    assert gripper.change("configure") and gripper.change("activate")
    gripper.wait_for_state("HOLDING")
    gripper.ok("release")


def test_two_grippers_in_one_process(grippers: Callable[..., Client], simulator: Simulator) -> None:
    with Simulator(part=50, homing_speed=400) as other:
        # No clock is published.
        options = {"use_sim_time": True, "home_on_activate": True}
        both = [grippers(address=it.tcp, prefix=f"{it.tcp[-1]}_", **options) for it in (simulator, other)]
        for client in both:
            client.wait_until_active()
        assert [wait_for(it).message for it in [client.begin("grip") for client in both]] == ["HOLDING"] * 2
        for client, width in zip(both, (20, 50)):
            wait_until(lambda: abs(client.joint_states[-1].position[0] * 2000 - width) < 1)
            client.wait_for_health("ready")
        assert both[1].joint_states[-1].name[0] == f"{other.tcp[-1]}_wsg_finger_left_joint"


def follows(client: Client, simulator: Simulator, position: float) -> None:
    """Publish a set-point until the fingers are there.

    A busy computer can keep the gripper from answering for 0.7 s, which ends a stream: then begin again, at most three times.
    """
    attempts = iter(range(3))

    def is_there() -> bool:
        if client.state() != "STREAMING":
            assert next(attempts, None) is not None, "the stream ends each time"
            wait_until(lambda: client.state() != "NO_CONNECTION")
            assert client.change("deactivate") and client.change("activate")
            client.wait_for_state("STREAMING")
        client.set_point(position)
        time.sleep(0.01)
        return abs(simulator.observe().width - 2000 * position) < 0.5

    wait_until(is_there, f"fingers at {position}")


def test_set_points_move_the_fingers_until_a_stop(grippers: Callable[..., Client], simulator: Simulator) -> None:
    simulator.set_part(None)
    client = grippers(address=simulator.tcp, mode="stream", home_on_activate=True, joint_state_rate=100.0, speed=0.4)
    client.wait_for_state("STREAMING")
    follows(client, simulator, 0.03)
    for refused in (0.056, -0.001, float("nan")):
        client.set_point(refused)
    client.set_point(0.04, "elbow")
    assert "BusyError" in client.call("grip")[1]
    follows(client, simulator, 0.02)
    client.ok("home")
    assert simulator.observe().width == pytest.approx(110, abs=0.1)
    follows(client, simulator, 0.02)
    for service in ("stop", "fast_stop"):
        client.ok(service)
        wait_until(lambda: client.state() not in ("STREAMING", "NO_CONNECTION"))
        for _ in range(20):
            client.set_point(0.05)
            time.sleep(0.01)
        assert simulator.observe().width == pytest.approx(40, abs=1), "a stream never resumes by itself"
        if service == "fast_stop":
            assert SystemFlags.FAST_STOP in simulator.observe().flags
            client.ok("acknowledge")
        assert client.change("deactivate") and client.change("activate")
        client.wait_for_state("STREAMING")
        follows(client, simulator, 0.02)
