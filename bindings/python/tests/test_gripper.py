"""The blocking driver, in virtual time unless a test needs a thread or a signal."""

from __future__ import annotations

import signal
import threading
from pathlib import Path
from typing import Callable, Optional, Union

import pytest

import wsg_gripper
from wsg_gripper import (
    AbortedError,
    BlockedError,
    BusyError,
    Gripper,
    GripperError,
    GripperState,
    GripResult,
    HomingDirection,
    InvalidError,
    Limits,
    NotConnectedError,
    RefusedError,
    SoftLimits,
    Statistics,
    Status,
    StoppedError,
    SystemFlags,
    UnansweredError,
    UnsupportedError,
)
from wsg_gripper.sim import Fault, Simulator, VirtualGripper


def test_grip_reports_whether_a_part_is_held(virtual: VirtualGripper, gripper: Gripper) -> None:
    assert gripper.grip(20, speed=100, force=40) is GripResult.HELD
    assert gripper.state() is GripperState.HOLDING
    assert gripper.force() == pytest.approx(40, abs=0.5)
    gripper.release(60, speed=200)
    assert gripper.width() == pytest.approx(60, abs=0.1)
    virtual.set_part(None)
    result = gripper.grip(20, speed=100)
    assert result is GripResult.NO_PART
    assert not result
    assert gripper.statistics() == Statistics(total=2, no_part=1, part_lost=0)


def grip_from_inside(simulated: Union[VirtualGripper, Simulator], gripper: Gripper) -> None:
    simulated.set_part(None)
    gripper.move(40, speed=200)
    simulated.set_part(80, inner_width=60)
    assert simulated.observe().part_is_between
    assert gripper.grip(60, speed=100, force=40) is GripResult.HELD
    assert gripper.width() == pytest.approx(60.4, abs=0.1)


def test_hollow_part_is_gripped_from_inside(virtual: VirtualGripper, gripper: Gripper) -> None:
    grip_from_inside(virtual, gripper)


def test_hollow_part_of_a_simulator_is_gripped_from_inside(wsg_sim: Simulator) -> None:
    with Gripper(wsg_sim.tcp) as gripper:
        gripper.home()
        grip_from_inside(wsg_sim, gripper)


@pytest.mark.parametrize(("width", "inner_width"), [(80, 80), (80, 0), (80, -1), (80, float("nan")), (None, 60)])
def test_impossible_inner_width_changes_no_part(
    virtual: VirtualGripper, width: Optional[float], inner_width: float
) -> None:
    with pytest.raises(InvalidError, match="inner width"):
        virtual.set_part(width, inner_width=inner_width)
    assert virtual.observe().part == 20


def test_lost_part_changes_the_state(virtual: VirtualGripper, gripper: Gripper) -> None:
    gripper.grip(20, speed=100)
    virtual.set_part(None)
    virtual.pass_time(0.1)
    assert gripper.state() is GripperState.PART_LOST


def test_virtual_time_gives_the_same_result_each_time() -> None:
    def program() -> tuple[float, float, float]:
        virtual = VirtualGripper(part=20)
        with virtual.connect() as gripper:
            gripper.home()
            gripper.grip(20, speed=100)
            return virtual.time, gripper.width(), gripper.force()

    first = program()
    assert first == program()
    assert first[0] > 1


def test_state_is_available_during_a_motion(gripper: Gripper) -> None:
    motion = gripper.begin_move(100, speed=20)
    assert motion.poll() is None
    assert not motion.done()
    assert SystemFlags.MOVING in gripper.flags()
    assert motion.wait() is None
    assert motion.poll() == (None,)
    gripper.move_by(-5, speed=50)
    assert gripper.width() == pytest.approx(95, abs=0.1)


def test_second_motion_is_busy_and_supersedes_none(gripper: Gripper) -> None:
    motion = gripper.begin_grip(20, speed=20)
    with pytest.raises(BusyError):
        gripper.move(50, speed=100)
    assert motion.wait() is GripResult.HELD


def test_settings_are_read_back(gripper: Gripper) -> None:
    gripper.set_force_limit(30)
    gripper.set_acceleration(500)
    gripper.set_soft_limits(10, 90)
    gripper.set_tag("cell 7")
    assert (gripper.force_limit(), gripper.acceleration()) == (30, 500)
    assert gripper.soft_limits() == SoftLimits(minus=10, plus=90)
    with pytest.raises(RefusedError) as refused:
        gripper.move(5, speed=100)
    assert refused.value.status is Status.E_RANGE_ERROR
    gripper.clear_soft_limits()
    assert gripper.soft_limits() is None
    assert gripper.tag() == "cell 7"
    gripper.set_overdrive(True)
    assert SystemFlags.OVERDRIVE_MODE in gripper.flags()
    gripper.set_force_limit(100)
    assert gripper.force_limit() == 100


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        (lambda it: it.grip(20, speed=100, force=500), "force 500 N is outside the gripper's limits, 5 to 80 N"),
        (lambda it: it.grip(20, speed=100, force=-1), "force -1 N"),
        (lambda it: it.grip(20, speed=1000, force=30), "speed 1000 mm/s"),
        (lambda it: it.begin_grip(-5, speed=100, force=30), "width -5 mm"),
        (lambda it: it.move(120, speed=100), "width 120 mm"),
        (lambda it: it.move_by(10, speed=100), "offset 10 mm"),
        (lambda it: it.release(50, speed=0), "speed 0 mm/s"),
        (lambda it: it.set_force_limit(81), "force 81 N"),
        (lambda it: it.set_acceleration(99999), "acceleration 99999 mm/s² is outside the gripper's limits, 100 to 5000 mm/s²"),
        (lambda it: it.set_soft_limits(-5, 90), "width -5 mm"),
        (lambda it: it.set_soft_limits(90, 20), "width 20 mm"),
    ],
)
def test_value_outside_the_limits_changes_nothing(
    gripper: Gripper, request_: Callable[[Gripper], object], message: str
) -> None:
    before = gripper.width(), gripper.force_limit(), gripper.acceleration(), gripper.soft_limits()
    with pytest.raises(InvalidError) as invalid:
        request_(gripper)
    assert str(invalid.value).startswith(message)
    assert (gripper.width(), gripper.force_limit(), gripper.acceleration(), gripper.soft_limits()) == before


def test_refused_grip_leaves_the_force_limit(gripper: Gripper) -> None:
    gripper.set_soft_limits(30, 110)
    before = gripper.force_limit()
    with pytest.raises(RefusedError) as refused:
        gripper.grip(20, speed=100, force=30)
    assert refused.value.status is Status.E_RANGE_ERROR
    assert gripper.force_limit() == before
    gripper.clear_soft_limits()
    assert gripper.grip(20, speed=100, force=30)
    assert gripper.force_limit() == 30


def test_requests_without_a_value_return_none(gripper: Gripper) -> None:
    requests: list[Callable[[], object]] = [
        lambda: gripper.set_force_limit(30),
        lambda: gripper.set_acceleration(500),
        lambda: gripper.set_soft_limits(0, 110),
        gripper.clear_soft_limits,
        lambda: gripper.set_overdrive(False),
        lambda: gripper.set_tag("cell 7"),
        lambda: gripper.loop_back(b"data"),
        lambda: gripper.move(50, speed=100),
        gripper.stop,
        gripper.fast_stop,
        gripper.acknowledge,
    ]
    for request in requests:
        assert request() is None


def test_device_describes_itself() -> None:
    with VirtualGripper(model="wsg32", serial_number=7, finger1="fmf").connect() as gripper:
        info = gripper.info()
        assert (info.device, info.serial_number) == ("WSG 32", 7)
        assert isinstance(gripper.limits(), Limits)
        assert gripper.limits().stroke == 68
        assert gripper.temperature() > 0
        assert gripper.finger_info(1) == ("WSG-FMF", 4)
        assert wsg_gripper.FingerFlags.POWER_ON in gripper.finger_flags(1)
        assert len(gripper.finger_data(1)) == 4
        gripper.loop_back(b"any bytes")
        assert gripper.tag() == ""


def test_fault_and_fast_stop_lock_the_fingers(virtual: VirtualGripper, gripper: Gripper) -> None:
    virtual.set_fault(Fault.AXIS_BLOCKED)
    with pytest.raises(BlockedError) as blocked:
        gripper.move(50, speed=100)
    assert blocked.value.status is Status.E_AXIS_BLOCKED
    virtual.set_fault(Fault.AXIS_BLOCKED, False)
    gripper.fast_stop()
    with pytest.raises(RefusedError) as refused:
        gripper.move(50, speed=100)
    assert refused.value.status is Status.E_ACCESS_DENIED
    gripper.acknowledge()
    gripper.move(50, speed=100)
    gripper.stop()


def test_unreferenced_fingers_refuse_to_move(virtual: VirtualGripper) -> None:
    with virtual.connect() as gripper, pytest.raises(RefusedError) as refused:
        gripper.grip(20, speed=100)
    assert refused.value.status is Status.E_NOT_INITIALIZED
    with virtual.connect() as gripper:
        gripper.home(HomingDirection.CLOSE)
        assert gripper.width() == 0


@pytest.mark.parametrize(
    ("address", "expected"),
    [
        ("192.168.1.20", "tcp://HOST"),
        ("tcp://host:port", "invalid port"),
        ("slcan:/dev/x?kbit=400", "10, 20, 50"),
    ],
)
def test_invalid_address_names_the_expected_form(address: str, expected: str) -> None:
    with pytest.raises(InvalidError, match=expected):
        Gripper(address)


def test_missing_gripper_is_a_connection_error() -> None:
    with Simulator() as simulator:
        address = simulator.tcp
    with pytest.raises(ConnectionError, match=address):
        Gripper(address)
    with pytest.raises(NotConnectedError):
        Gripper("serial:/dev/no-such-device")


def test_cut_line_is_unanswered(virtual: VirtualGripper, gripper: Gripper) -> None:
    virtual.cut_line()
    with pytest.raises(UnansweredError):
        gripper.set_tag("lost")
    virtual.close_line()
    with pytest.raises(NotConnectedError):
        gripper.width()


def test_invalid_parameters_are_value_errors(gripper: Gripper) -> None:
    with pytest.raises(ValueError, match="invalid parameter"):
        gripper.move(float("nan"), speed=100)
    with pytest.raises(InvalidError):
        gripper.finger_info(3)
    with pytest.raises(UnsupportedError):
        gripper.clamping_travel()
    with pytest.raises(InvalidError, match="option|argument"):
        VirtualGripper(no_such_option=1)


def test_text_protocol_has_the_same_methods() -> None:
    virtual = VirtualGripper("gcl", part=20)
    with virtual.connect() as gripper:
        gripper.home()
        assert gripper.grip(20, speed=100, force=40) is GripResult.HELD
        assert gripper.set_part_width_tolerance(3) == 3
        assert gripper.part_width_tolerance() == 3
        assert gripper.set_clamping_travel(4) == gripper.clamping_travel() == 4


def test_limits_over_the_text_protocol_are_the_stroke_and_those_of_the_address() -> None:
    with Simulator(time_scale=10) as simulator:
        with Gripper(simulator.gcl) as gripper:
            gripper.home()
            with pytest.raises(InvalidError, match="width 110.5 mm .* 0 to 110 mm"):
                gripper.move(110.5, speed=100)
            gripper.set_force_limit(500)
        with Gripper(simulator.gcl + "?force=5..60&speed=5..300") as gripper:
            with pytest.raises(InvalidError, match="force 61 N .* 5 to 60 N"):
                gripper.set_force_limit(61)
            with pytest.raises(InvalidError, match="speed 301 mm/s .* 5 to 300 mm/s"):
                gripper.move(50, speed=301)


def test_announced_end_leaves_no_fast_stop_and_an_unannounced_one_does(virtual: VirtualGripper) -> None:
    with virtual.connect() as gripper:
        gripper.home()
        gripper.begin_move(10, speed=5)
    assert not gripper.is_open
    with pytest.raises(NotConnectedError):
        gripper.width()
    gripper.close()
    assert SystemFlags.FAST_STOP not in virtual.observe().flags
    assert SystemFlags.MOVING not in virtual.observe().flags
    gripper = virtual.connect()
    with pytest.raises(BusyError):
        virtual.connect()
    virtual.close_line()
    assert SystemFlags.FAST_STOP in virtual.observe().flags


@pytest.mark.parametrize("line", ["tcp", "udp", "gcl", "gcl_udp"])
def test_every_line_of_the_simulator_is_an_address(line: str) -> None:
    with Simulator(part=20, time_scale=10) as simulator, Gripper(getattr(simulator, line)) as gripper:
        gripper.home()
        assert gripper.grip(20, speed=100, force=30)
        assert simulator.observe().state is GripperState.HOLDING


def test_queries_of_another_thread_pass_a_grip(simulator: Simulator) -> None:
    with Gripper(simulator.tcp) as gripper:
        gripper.home()
        results: list[GripResult] = []
        thread = threading.Thread(target=lambda: results.append(gripper.grip(20, speed=60)))
        thread.start()
        widths = []
        while thread.is_alive():
            widths.append(gripper.width())
        thread.join()
        assert results == [GripResult.HELD]
        # The last query of a busy machine may be long before the result.
        assert len(set(widths)) > 10
        widths.append(gripper.width())
        assert len(widths) > 20
        assert widths[0] > 90 and widths[-1] < 30


def test_queries_and_motions_of_many_threads_pass_a_grip(simulator: Simulator) -> None:
    with Gripper(simulator.tcp) as gripper:
        gripper.home()
        motion = gripper.begin_grip(20, speed=60)
        results: list[object] = []
        threads = [threading.Thread(target=lambda: results.append(motion.wait())) for _ in range(3)]
        for thread in threads:
            thread.start()
        while any(thread.is_alive() for thread in threads):
            gripper.force()
        assert results == [GripResult.HELD] * 3


def test_ctrl_c_stops_the_fingers(simulator: Simulator) -> None:
    main = threading.main_thread().ident
    assert main is not None
    with Gripper(simulator.tcp) as gripper:
        gripper.home()

        def interrupt() -> None:
            while SystemFlags.MOVING not in simulator.observe().flags:
                pass
            signal.pthread_kill(main, signal.SIGINT)

        thread = threading.Thread(target=interrupt)
        thread.start()
        with pytest.raises(KeyboardInterrupt):
            gripper.grip(20, speed=5)
        thread.join()
        assert SystemFlags.MOVING not in simulator.observe().flags
        assert simulator.observe().width > 100
        assert SystemFlags.FAST_STOP not in gripper.flags()


def test_signal_handler_may_stop_the_gripper(simulator: Simulator) -> None:
    main = threading.main_thread().ident
    assert main is not None
    with Gripper(simulator.tcp) as gripper:
        gripper.home()

        def interrupt() -> None:
            while SystemFlags.MOVING not in simulator.observe().flags:
                pass
            signal.pthread_kill(main, signal.SIGUSR1)

        before = signal.signal(signal.SIGUSR1, lambda *_: gripper.stop())
        thread = threading.Thread(target=interrupt)
        thread.start()
        try:
            with pytest.raises(StoppedError):
                gripper.grip(20, speed=5)
        finally:
            signal.signal(signal.SIGUSR1, before)
            thread.join()


def test_stop_of_another_client_aborts_a_motion(simulator: Simulator) -> None:
    with Gripper(simulator.tcp) as gripper, Gripper(simulator.udp) as other:
        gripper.home()
        motion = gripper.begin_move(10, speed=5)
        other.stop()
        with pytest.raises(AbortedError) as aborted:
            motion.wait()
        assert aborted.value.status is Status.E_CMD_ABORTED


def test_errors_are_sorted_by_cause() -> None:
    errors = [getattr(wsg_gripper, name) for name in wsg_gripper.__all__ if name.endswith("Error")]
    assert all(issubclass(error, GripperError) for error in errors)
    assert issubclass(UnansweredError, TimeoutError)
    assert GripperError("no status").status is None
    assert GripperError("unknown", 99).status == 99


def test_failed_script_is_noticed(tmp_path: Path) -> None:
    script = tmp_path / "script.lua"
    script.write_text("error('intended')")
    with Simulator(script=script) as simulator, pytest.raises(RefusedError) as refused:
        simulator.wait_for_script(seconds=0.1)
    assert refused.value.status is Status.E_CMD_UNKNOWN


def test_fixture_starts_a_simulator(wsg_sim: Simulator) -> None:
    with Gripper(wsg_sim.tcp) as gripper:
        gripper.home()
        wsg_sim.set_part(30)
        assert gripper.grip(30, speed=100)
