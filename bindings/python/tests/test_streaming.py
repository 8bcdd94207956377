"""Set-point streaming against the simulator, with the script and without."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy
import pytest

from wsg_gripper import (
    Gripper,
    HomingDirection,
    InvalidError,
    NotConnectedError,
    StreamEndedError,
    StreamingGripper,
    SystemFlags,
    UnsupportedError,
)
from wsg_gripper.sim import Simulator
from wsg_gripper.umi import WSGController


@pytest.fixture
def scripted(tmp_path: Path) -> Iterator[Simulator]:
    """A gripper on which the script runs."""
    script = tmp_path / "wsg_stream.lua"
    script.write_text(StreamingGripper.SCRIPT)
    with Simulator(script=script, homing_speed=400) as simulator:
        simulator.wait_for_script()
        yield simulator


def wait_for(condition: Callable[[], bool], seconds: float = 10) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "time-out"
        time.sleep(0.002)


def test_fingers_follow_scheduled_waypoints(scripted: Simulator) -> None:
    with StreamingGripper(scripted.tcp, home=HomingDirection.OPEN) as gripper:
        assert gripper.backend == "script"
        assert gripper.is_ready
        assert gripper.latest().set_point is None
        begin = time.time()
        gripper.schedule_waypoint(100, begin + 0.1)
        gripper.schedule_waypoint(80, begin + 0.5)
        wait_for(lambda: gripper.latest().position < 80.5)
        late = time.time() - begin - 0.5
        assert -0.05 < late < 1
        sample = gripper.latest()
        assert sample.set_point == pytest.approx(80)
        assert sample.measured <= sample.received <= time.time()
        assert time.time() - sample.received < 1
        history = numpy.asarray(gripper.history())
        assert history.shape[1] == 8
        assert (numpy.diff(history[:, 0]) == 1).all()
        assert (numpy.diff(history[:, 2]) >= -0.001).all()
        assert history[0, 3] > 100 and history[-1, 3] < 81
    assert gripper.ended is not None
    assert not gripper.is_ready
    assert gripper.latest().position == pytest.approx(80, abs=1)
    with pytest.raises(StreamEndedError):
        gripper.schedule_waypoint(50, time.time())
    assert SystemFlags.FAST_STOP not in scripted.observe().flags


def test_latest_state_never_waits_for_the_gripper(scripted: Simulator) -> None:
    computing = threading.Event()

    def compute() -> None:
        while not computing.is_set():
            sum(range(1000))

    thread = threading.Thread(target=compute)
    with StreamingGripper(scripted.tcp, home=None) as gripper:
        first = gripper.latest().number
        thread.start()
        try:
            wait_for(lambda: gripper.latest().number > first + 20)
        finally:
            computing.set()
            thread.join()


def test_limits_and_target_take_effect(scripted: Simulator) -> None:
    with StreamingGripper(scripted.tcp, home=HomingDirection.OPEN, max_speed=50, force=20) as gripper:
        gripper.set_target(90)
        wait_for(lambda: gripper.latest().position < 90.5)
        assert numpy.asarray(gripper.history())[:, 4].min() > -60
        gripper.set_speed_limit(400)
        gripper.set_force_limit(30)
        gripper.set_target(60)
        wait_for(lambda: gripper.latest().position < 60.5)
        with pytest.raises(InvalidError):
            gripper.set_target(float("nan"))
        with pytest.raises(InvalidError):
            gripper.schedule_waypoint(60, float("inf"))


def test_without_a_script_the_fingers_pre_position() -> None:
    with Simulator(homing_speed=400) as simulator, StreamingGripper(simulator.tcp) as gripper:
        assert gripper.backend == "pre-position"
        gripper.set_target(90)
        wait_for(lambda: gripper.latest().position < 91)


def test_fast_stop_ends_the_stream(scripted: Simulator) -> None:
    with StreamingGripper(scripted.tcp) as gripper:
        gripper.set_target(50)
        wait_for(lambda: gripper.latest().position < 105)
        gripper.fast_stop()
        wait_for(lambda: gripper.ended is not None)
        assert "FAST STOP" in str(gripper.ended)
    assert SystemFlags.FAST_STOP in scripted.observe().flags


def test_stop_of_another_client_ends_the_stream(scripted: Simulator) -> None:
    with StreamingGripper(scripted.tcp) as gripper, Gripper(scripted.udp) as other:
        gripper.set_target(50)
        wait_for(lambda: gripper.latest().position < 105)
        other.stop()
        wait_for(lambda: gripper.ended is not None)
        assert gripper.ended == "another client stopped the fingers"


def test_start_without_waiting_reports_its_failure() -> None:
    with Simulator() as simulator:
        address = simulator.tcp
    gripper = StreamingGripper(address)
    with pytest.raises(NotConnectedError, match="start"):
        gripper.latest()
    gripper.start(wait=False)
    with pytest.raises(NotConnectedError):
        gripper.start_wait()
    assert not gripper.is_ready
    gripper.stop()
    with pytest.raises(UnsupportedError):
        StreamingGripper("gcl://127.0.0.1").start()


def test_umi_controller_has_the_states_of_umi(scripted: Simulator) -> None:
    host, port = scripted.tcp.removeprefix("tcp://").split(":")
    controller = WSGController(
        None, host, int(port), frequency=100, receive_latency=0.01, use_meters=True, home_to_open=True
    )
    controller.start(wait=False)
    controller.start_wait()
    try:
        controller.restart_put(time.time())
        controller.schedule_waypoint(0.09, time.time() + 0.2)
        wait_for(lambda: bool(controller.get_state()["gripper_position"] < 0.0905))
        state = controller.get_all_state()
        assert sorted(state) == [
            "gripper_force",
            "gripper_measure_timestamp",
            "gripper_position",
            "gripper_receive_timestamp",
            "gripper_state",
            "gripper_timestamp",
            "gripper_velocity",
        ]
        assert all(values.ndim == 1 for values in state.values())
        assert state["gripper_receive_timestamp"] - state["gripper_timestamp"] == pytest.approx(0.01)
        last = controller.get_state(k=5)
        assert last["gripper_position"].shape == (5,)
        assert controller.get_state(5, out=last) is last
    finally:
        controller.stop(wait=False)
        controller.stop_wait()
