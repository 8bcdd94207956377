"""Requests that come while others wait: nothing runs late, twice or after a stop, and nothing fails silently."""

from __future__ import annotations

import threading
import time
from typing import Any, Callable

import pytest
from conftest import Client, is_moving, wait_for, wait_until
from rclpy.action.server import ServerGoalHandle
from wsg_gripper import Gripper, SystemFlags
from wsg_gripper.sim import Simulator
from wsg_gripper_driver import link, node


class Held:
    """Holds each call of a method until it is released."""

    def __init__(self, monkeypatch: Any, owner: Any, method: str) -> None:
        self.entered, self.released = threading.Event(), threading.Event()
        held, call = self, getattr(owner, method)

        def wrapper(*arguments: Any) -> Any:
            held.entered.set()
            assert held.released.wait(60)
            return call(*arguments)

        monkeypatch.setattr(owner, method, wrapper)

    def during(self, act: Callable[[], Any]) -> Any:
        """Return the future of a request that begins in the call and is not answered for a while, or at once."""
        assert self.entered.wait(60)
        future = act()
        end = time.monotonic() + 0.4
        while not future.done() and time.monotonic() < end:
            time.sleep(0.01)
        self.released.set()
        return future


def keeps_width(client: Client, simulator: Simulator) -> None:
    width = simulator.observe().width
    for _ in range(20):
        client.set_point(0.05)
        time.sleep(0.01)
    assert simulator.observe().width == pytest.approx(width, abs=0.1) and not is_moving(simulator)


def test_stop_during_the_start_prevents_the_activation(monkeypatch: Any, grippers: Any, simulator: Simulator) -> None:
    opening = Held(monkeypatch, link.Requests, "__init__")
    client = grippers(address=simulator.tcp, home_on_activate=True)
    assert wait_for(opening.during(lambda: client.begin("stop"))).success
    client.wait_for_diagnosed("last error", "not activated: stopped by ~/stop")
    assert client.lifecycle() == "inactive" and simulator.observe().speed == 0


def test_stop_during_the_homing_of_an_activation(grippers: Any) -> None:
    with Simulator(homing_speed=5) as simulator:
        client = grippers(address=simulator.tcp, home_on_activate=True)
        wait_until(lambda: is_moving(simulator))
        assert client.lifecycle() == "activating", "a query does not wait"
        assert not client.change("deactivate"), "no transition waits for another one"
        client.ok("fast_stop")
        wait_until(lambda: not is_moving(simulator))
        wait_until(lambda: client.lifecycle() == "inactive")


def test_fast_stop_while_a_stream_opens(monkeypatch: Any, grippers: Any, simulator: Simulator) -> None:
    opening = Held(monkeypatch, node.Stream, "__init__")
    client = grippers(address=simulator.tcp, mode="stream", home_on_activate=True)
    assert wait_for(opening.during(lambda: client.begin("fast_stop"))).success
    wait_until(lambda: client.lifecycle() == "inactive")
    assert SystemFlags.FAST_STOP in simulator.observe().flags
    client.wait_for_state("ERROR")
    keeps_width(client, simulator)


@pytest.mark.parametrize("stop", ["stop", "fast_stop"])
def test_stop_during_an_acknowledgement(monkeypatch: Any, grippers: Any, simulator: Simulator, stop: str) -> None:
    client = grippers(address=simulator.tcp, mode="stream", home_on_activate=True)
    client.wait_for_state("STREAMING")
    acknowledging = Held(monkeypatch, Gripper, "acknowledge")
    acknowledgement = client.begin("acknowledge")
    assert wait_for(acknowledging.during(lambda: client.begin(stop))).success
    assert wait_for(acknowledgement).message == f"Halted: stopped by ~/{stop}"
    client.wait_for_state("IDLE" if stop == "stop" else "ERROR")
    assert (SystemFlags.FAST_STOP in simulator.observe().flags) == (stop == "fast_stop")
    keeps_width(client, simulator)


@pytest.mark.parametrize("end", ["stop", "cancel"])
def test_goal_that_ends_before_its_begin_moves_nothing(
    monkeypatch: Any, gripper: Client, simulator: Simulator, end: str
) -> None:
    pytest.importorskip("control_msgs.action")
    from test_action import GoalStatus, Goals

    goals = Goals(gripper)
    admitting = Held(monkeypatch, ServerGoalHandle, "execute")
    handle = goals.send([0.01])
    ended = admitting.during(handle.cancel_goal_async if end == "cancel" else lambda: gripper.begin("stop"))
    wait_for(ended)
    expected = GoalStatus.STATUS_CANCELED if end == "cancel" else GoalStatus.STATUS_ABORTED
    assert goals.outcome(handle)[0] == expected
    assert simulator.observe().width == pytest.approx(110, abs=0.1) and not is_moving(simulator)


def test_failures_are_reported_and_the_connection_returns(monkeypatch: Any, gripper: Client) -> None:
    def fail(*_: Any) -> None:
        raise OSError("a defect")

    wait_until(lambda: gripper.joint_states)
    with monkeypatch.context() as patch:
        patch.setattr(gripper.driver._joint_states, "publish", fail)
        gripper.wait_for_health("a defect")
    gripper.wait_for_state("IDLE")
    with monkeypatch.context() as patch:
        patch.setattr(Gripper, "fast_stop", fail)
        assert gripper.call("fast_stop") == (False, "OSError: a defect")
    reading = Held(monkeypatch, link.Requests, "read")
    assert gripper.wait_for_health("no state for").level == b"\3", "an old state is not shown as current"
    reading.released.set()
    gripper.wait_for_health("ready")


def test_clock_that_is_set_back_does_not_renew_an_old_state(monkeypatch: Any, gripper: Client) -> None:
    gripper.wait_for_health("ready")
    reading, clock = Held(monkeypatch, link.Requests, "read"), time.time
    monkeypatch.setattr(time, "time", lambda: clock() - 3600)
    assert gripper.wait_for_health("no state for").level == b"\3"
    reading.released.set()
