"""Set-point streaming against the simulator, with the script and without."""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy
import pytest

from wsg_gripper import (
    AbortedError,
    BusyError,
    Gripper,
    GripperError,
    HomingDirection,
    InvalidError,
    NotConnectedError,
    StoppedError,
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
    assert gripper.history()[-1, 3] == pytest.approx(80, abs=1)
    for request in (gripper.latest, lambda: gripper.schedule_waypoint(50, time.time())):
        with pytest.raises(StreamEndedError, match="the caller ended"):
            request()
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


def test_time_in_another_unit_is_refused_and_moves_nothing(scripted: Simulator) -> None:
    with StreamingGripper(scripted.tcp) as gripper:
        gripper.set_target(70)
        wait_for(lambda: abs(gripper.latest().position - 70) < 0.2)
        for wrong, text in [
            ((time.time() + 0.5) * 1000, r"target_time is 1\.\de12 s ahead; .* seconds of time\.time\(\), at most 3600 s"),
            ((time.time() + 0.5) * 1e6, "s ahead"),
            (time.time() + 3700, "target_time is 3700 s ahead"),
            (time.monotonic() + 0.5, "s in the past"),
            (math.nan, "target_time is NaN; expected seconds"),
            (math.inf, "target_time is inf"),
            (-math.inf, "target_time is -inf"),
        ]:
            for position in (72, 40):
                with pytest.raises(InvalidError, match=text):
                    gripper.schedule_waypoint(position, wrong)
        number = gripper.latest().number
        wait_for(lambda: gripper.latest().number > number + 20)
        assert gripper.latest().set_point == 70
        gripper.schedule_waypoint(72, time.time() - 5)
        wait_for(lambda: gripper.latest().set_point == 72)


def test_values_outside_the_limits_are_refused_by_name(scripted: Simulator) -> None:
    with StreamingGripper(scripted.tcp) as gripper:
        assert gripper.limits.stroke == 110
        requests: list[tuple[Callable[[], None], str]] = [
            (lambda: gripper.set_target(110.5), "width 110.5 mm is outside the gripper's limits, 0 to 110 mm"),
            (lambda: gripper.schedule_waypoint(-0.1, time.time() + 1), "width -0.1 mm is outside"),
            (lambda: gripper.set_target(math.nan), "width NaN mm is outside"),
            (lambda: gripper.set_speed_limit(1), "speed 1 mm/s is outside the gripper's limits, 5 to 420 mm/s"),
            (lambda: gripper.set_force_limit(500), "force 500 N is outside the gripper's limits, 5 to 80 N"),
        ]
        for request, text in requests:
            with pytest.raises(InvalidError, match=text):
                request()
        assert gripper.latest().set_point is None
    assert scripted.observe().force_limit == 40


def test_limits_are_checked_before_homing(scripted: Simulator) -> None:
    for gripper in (
        StreamingGripper(scripted.tcp, force=500),
        StreamingGripper(scripted.tcp, force=-1),
        StreamingGripper(scripted.tcp, max_speed=1000),
    ):
        with pytest.raises(InvalidError, match="outside the gripper's limits"):
            gripper.start()
        seen = scripted.observe()
        assert seen.flags & (SystemFlags.REFERENCED | SystemFlags.FAST_STOP) == SystemFlags(0)
        assert seen.force_limit == 40


def test_rate_and_queue_have_limits() -> None:
    for frequency in (0.5, 501, math.nan):
        with pytest.raises(InvalidError, match="expected 1 to 500"):
            StreamingGripper("tcp://127.0.0.1", frequency)
    for size in (0, 4097):
        with pytest.raises(InvalidError, match="expected 1 to 4096"):
            StreamingGripper("tcp://127.0.0.1", queue_size=size)


def test_running_stream_homes_and_is_acknowledged() -> None:
    # The fingers take a second to home.
    with Simulator(homing_speed=60) as simulator, StreamingGripper(simulator.tcp, home=None) as gripper:
        # Not referenced: samples arrive nevertheless.
        wait_for(lambda: gripper.latest().number > 20)
        gripper.home(HomingDirection.OPEN)
        gripper.set_target(20)
        wait_for(lambda: gripper.latest().position < 90)
        results: list[BaseException | None] = []

        def home() -> None:
            try:
                gripper.home(HomingDirection.OPEN)
                results.append(None)
            except GripperError as failure:
                results.append(failure)

        homing = threading.Thread(target=home)
        homing.start()
        wait_for(lambda: gripper.latest().speed > 50 or bool(results))
        waypoint = partial(gripper.schedule_waypoint, 50, time.time())
        for request in (gripper.home, gripper.acknowledge, partial(gripper.set_target, 50), waypoint):
            with pytest.raises(BusyError, match="homing"):
                request()
        homing.join()
        assert results == [None] and simulator.observe().width == 110
        gripper.set_target(60)
        wait_for(lambda: gripper.latest().position < 61)
        # A FAST STOP ends a homing and the stream, until it is acknowledged.
        homing = threading.Thread(target=home)
        homing.start()
        wait_for(lambda: gripper.latest().speed > 50)
        gripper.fast_stop()
        homing.join()
        assert isinstance(results[-1], (StoppedError, StreamEndedError, AbortedError))
        wait_for(lambda: gripper.ended is not None)
        for ended in (gripper.home, gripper.latest):
            with pytest.raises(StreamEndedError, match="FAST STOP"):
                ended()
        gripper.acknowledge()
        assert gripper.ended is None and gripper.latest().set_point is None
        assert SystemFlags.FAST_STOP not in simulator.observe().flags
        gripper.home(HomingDirection.OPEN)
        with Gripper(simulator.udp) as other:
            gripper.set_target(60)
            wait_for(lambda: gripper.latest().speed < -5)
            other.stop()
            wait_for(lambda: gripper.ended is not None)
        with pytest.raises(StreamEndedError, match="another client"):
            gripper.acknowledge()


@contextmanager
def proxy(address: str) -> Iterator[tuple[str, threading.Event]]:
    """Address of a line to the gripper that passes bytes while the event is set."""
    host, port = address.removeprefix("tcp://").split(":")
    passes = threading.Event()
    passes.set()
    with socket.create_server(("127.0.0.1", 0)) as server:
        near, far = socket.socket(), socket.create_connection((host, int(port)))

        def copy(source: socket.socket, target: socket.socket) -> None:
            try:
                while data := source.recv(4096):
                    passes.wait()
                    target.sendall(data)
            except OSError:
                pass

        def serve() -> None:
            nonlocal near
            near = server.accept()[0]
            for end in (near, far):
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=copy, args=(far, near), daemon=True).start()
            copy(near, far)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        try:
            yield f"tcp://127.0.0.1:{server.getsockname()[1]}", passes
        finally:
            passes.set()
            near.close()
            far.close()


@pytest.mark.parametrize("has_script", [True, False])
def test_pause_of_the_gripper_is_a_gap_and_no_end(has_script: bool, tmp_path: Path) -> None:
    script = tmp_path / "wsg_stream.lua"
    script.write_text(StreamingGripper.SCRIPT)
    options = {"script": script} if has_script else {}
    with Simulator(homing_speed=400, **options) as simulator:
        if has_script:
            simulator.wait_for_script()
        with proxy(simulator.tcp) as (address, passes), StreamingGripper(address, max_speed=20) as gripper:
            gripper.set_target(40)
            wait_for(lambda: gripper.latest().position < 108)
            # A busy machine may pause, too.
            before = len(gripper.gaps())
            passes.clear()
            wait_for(lambda: gripper.latest().age > 0.24)
            passes.set()
            wait_for(lambda: len(gripper.gaps()) > before)
            gap = gripper.gaps()[before]
            assert 0.1 < gap.length < 1 and gap.begin < time.time()
            position = gripper.latest().position
            wait_for(lambda: gripper.latest().position < position - 1)
            assert numpy.asarray(gripper.history())[:, 4].min() > -25


@pytest.mark.parametrize("has_script", [True, False])
def test_timestamps_increase_strictly_from_the_first_observation_on(has_script: bool, tmp_path: Path) -> None:
    script = tmp_path / "wsg_stream.lua"
    script.write_text(StreamingGripper.SCRIPT)
    options = {"script": script} if has_script else {}
    with Simulator(homing_speed=400, **options) as simulator:
        if has_script:
            simulator.wait_for_script()
        host, port = simulator.tcp.removeprefix("tcp://").split(":")
        with WSGController(None, host, int(port), command_queue_size=1000) as controller:
            assert controller.backend == ("script" if has_script else "pre-position")
            first = controller.get_all_state()
            assert len(first["gripper_timestamp"]) >= 2
            controller.schedule_waypoint(80, time.time() + 0.5)
            wait_for(lambda: len(controller.get_all_state()["gripper_timestamp"]) > 60)
            for states in (first, controller.get_all_state()):
                assert all(numpy.isfinite(values).all() for values in states.values())
                for key in ("gripper_timestamp", "gripper_measure_timestamp", "gripper_receive_timestamp"):
                    assert (numpy.diff(states[key]) > 0).all(), states[key]


def test_calibration_of_umi_schedules_a_thousand_waypoints_ahead(scripted: Simulator) -> None:
    host, port = scripted.tcp.removeprefix("tcp://").split(":")
    for size in (1000, 4096):
        with WSGController(None, host, int(port), command_queue_size=size) as controller:
            begin = time.time() + 60
            for step in range(size):
                controller.schedule_waypoint(80 + 20 * math.sin(step), begin + step / 100)
            with pytest.raises(BusyError, match=f"{size} earlier"):
                controller.schedule_waypoint(80, begin + 60)
    with pytest.raises(InvalidError, match="1 to 4096"):
        WSGController(None, host, int(port), command_queue_size=4097)


def test_no_state_is_returned_after_the_connection_is_lost(tmp_path: Path) -> None:
    with Simulator(homing_speed=400) as simulator:
        host, port = simulator.tcp.removeprefix("tcp://").split(":")
        controller = WSGController(None, host, int(port))
        controller.start()
        assert 0 <= controller.latest().age < 10
    wait_for(lambda: controller.ended is not None)
    for read in (controller.latest, controller.get_state, controller.get_all_state):
        with pytest.raises(StreamEndedError):
            read()
    assert len(controller.history()) > 0
    controller.stop()


def test_state_never_waits_for_the_end_of_the_connection(scripted: Simulator) -> None:
    with proxy(scripted.tcp) as (address, passes):
        gripper = StreamingGripper(address, home=None)
        gripper.start()
        passes.clear()
        closing = threading.Thread(target=gripper.stop)
        closing.start()
        wait_for(lambda: gripper.ended is not None)
        # The end waits for a gripper that does not answer. A reading that waited, too, would hold the interpreter.
        readings = 0
        while closing.is_alive():
            readings += gripper.ended is not None
            time.sleep(0.001)
        assert readings > 20
