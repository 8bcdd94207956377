"""Subscriptions of the drivers and of streams, over sockets and in virtual time."""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable
from itertools import islice

import pytest
from test_streaming import proxy, wait_for

from wsg_gripper import (
    AsyncGripper,
    BusyError,
    Gripper,
    GripperError,
    GripperState,
    InvalidError,
    NotConnectedError,
    Reading,
    StoppedError,
    StreamEndedError,
    Subscription,
    SystemFlags,
)
from wsg_gripper.sim import Simulator, VirtualGripper
from wsg_gripper.umi import WSGController


def per_second(count: int, readings: Subscription[Reading], target: float) -> float:
    """Return the rate of readings over ``count`` of them, at the target or after many attempts: the computer may pause."""
    last = deque(islice(readings, count), count)
    for reading in islice(readings, 2000):
        rate = (count - 1) / (last[-1].received - last[0].received)
        if rate >= target:
            break
        last.append(reading)
    return rate


@pytest.mark.parametrize(("names", "rate"), [(("width", "speed", "force"), 40), (("width", "force"), 60), (("width",), 95)])
def test_gripper_with_real_latencies_sends_a_hundred_values_a_second(names: tuple[str, ...], rate: float) -> None:
    with Simulator(profile="real", homing_speed=400) as simulator, Gripper(simulator.tcp) as gripper:
        gripper.home()
        motion = gripper.begin_move(30, speed=20)
        wanted = {name: name in names for name in ("width", "speed", "force")}
        with gripper.subscribe(**wanted) as readings:
            assert per_second(50, readings, rate) >= rate
            reading = next(readings)
            assert [name for name in wanted if getattr(reading, name) is not None] == list(names)
            # Queries and stops pass, and the updates continue.
            assert gripper.width() == pytest.approx(next(readings).width, abs=5)
            gripper.stop()
            while SystemFlags.MOVING in next(readings).flags:
                pass
        with pytest.raises(GripperError):
            motion.wait()


@pytest.mark.parametrize("line", ["tcp", "serial", "gcl"])
def test_readings_follow_a_grip_and_end_with_the_line(line: str) -> None:
    virtual = VirtualGripper(line, part=20)
    gripper = virtual.connect()
    with gripper.subscribe(0.05, speed=False) as readings:
        first = next(readings)
        assert first[1:5] == (None, None, 0, GripperState.IDLE)
        with pytest.raises(BusyError, match="close it first"):
            gripper.subscribe()
        gripper.home()
        grip = gripper.begin_grip(20, speed=100, force=40)
        seen = []
        for reading in readings:
            seen.append(reading)
            if reading.state is GripperState.HOLDING:
                break
        assert grip.wait()
        widths = [reading.width for reading in seen if reading.width is not None]
        # The state may be an interval newer than the values.
        assert widths[0] > 100 and widths[-1] < 26 and len(set(widths)) > 10
        assert 0 <= seen[-1].age < 1 and seen[-1].force is not None and seen[-1].force > 30
    with pytest.raises(StopIteration):
        next(readings)
    with gripper.subscribe(0.2) as readings:
        next(readings)
        virtual.cut_line()
        begin = virtual.time
        for _ in range(2):
            with pytest.raises(NotConnectedError):
                deque(readings, 0)
        assert virtual.time - begin < 1
    gripper.close()


def test_slow_loop_gets_the_newest_reading_and_none_after_the_end(simulator: Simulator) -> None:
    with Gripper(simulator.tcp) as gripper:
        readings = gripper.subscribe()

        def is_current_after_a_pause() -> bool:
            next(readings)
            time.sleep(0.3)
            return next(readings).age < 0.2

        wait_for(is_current_after_a_pause, 60)
        time.sleep(0.3)
        gripper.close()
        with pytest.raises(NotConnectedError):
            next(readings)


@pytest.mark.parametrize("end", ["gripper off", "gripper frozen", "closed"])
def test_loop_ends_with_the_connection(end: str, simulator: Simulator) -> None:
    with proxy(simulator.tcp) as (address, passes), Gripper(address) as gripper:
        readings = gripper.subscribe()
        next(readings)
        ends = {"gripper off": simulator.close, "gripper frozen": passes.clear, "closed": gripper.close}
        ending = threading.Timer(0.1, ends[end])
        ending.start()
        with pytest.raises(NotConnectedError):
            deque(readings, 0)
        ending.join()
        passes.set()


def test_acknowledgement_that_waits_during_a_fast_stop_is_withdrawn(simulator: Simulator) -> None:
    def is_withdrawn() -> bool:
        outcomes: list[type[BaseException]] = []

        def request(act: Callable[[], object]) -> None:
            try:
                act()
            except GripperError as failure:
                outcomes.append(type(failure))

        with proxy(simulator.tcp) as (address, passes), Gripper(address) as gripper:
            gripper.acknowledge()
            passes.clear()
            # The query waits for its answer and keeps the driver.
            acts = (gripper.width, gripper.acknowledge, gripper.fast_stop)
            threads = [threading.Thread(target=request, args=(act,)) for act in acts]
            for thread in threads:
                thread.start()
                time.sleep(0.05)
            passes.set()
            for thread in threads:
                thread.join()
            is_locked = SystemFlags.FAST_STOP in simulator.observe().flags
        return is_locked and outcomes == [StoppedError, StoppedError]

    # If the computer pauses, the requests are made in another order.
    wait_for(is_withdrawn, 60)


def test_close_of_another_thread_ends_the_loop_normally(simulator: Simulator) -> None:
    with Gripper(simulator.tcp) as gripper:
        readings = gripper.subscribe()
        closing = threading.Timer(0.1, readings.close)
        closing.start()
        deque(readings, 0)
        closing.join()
        # A dropped subscription is closed, too.
        next(gripper.subscribe())
        next(gripper.subscribe())


def test_invalid_subscriptions_are_refused(simulator: Simulator) -> None:
    with Gripper(simulator.tcp) as gripper:
        requests: list[tuple[Callable[[], object], str]] = [
            (lambda: gripper.subscribe(0.02), "interval is 0.02 s; expected 0.024 to 1 s for 3 values"),
            (lambda: gripper.subscribe(0.009, speed=False, force=False), "expected 0.01 to 1 s"),
            (lambda: gripper.subscribe(float("nan")), "interval is NaN"),
            (lambda: gripper.subscribe(width=False, speed=False, force=False), "no value"),
        ]
        for subscribe, text in requests:
            with pytest.raises(InvalidError, match=text):
                subscribe()
    with pytest.raises(NotConnectedError):
        gripper.subscribe()


def test_asyncio_iterates_beside_a_motion(simulator: Simulator) -> None:
    async def program() -> None:
        async with AsyncGripper(simulator.tcp) as gripper:
            await gripper.home()
            grip = asyncio.create_task(gripper.grip(20, speed=100))
            async with gripper.subscribe() as readings:
                widths, cancelled = [], 0
                async for reading in readings:
                    widths.append(reading.width)
                    # A cancelled wait ends nothing, and loses nothing.
                    try:
                        widths.append((await asyncio.wait_for(readings.__anext__(), 1e-4)).width)
                    except asyncio.TimeoutError:
                        cancelled += 1
                    # The last width may arrive after the result.
                    if grip.done() and widths[-1] == pytest.approx(20, abs=1):
                        break
                assert await grip and cancelled and len(widths) > 5 and widths[-1] == pytest.approx(20, abs=1)
            assert [reading async for reading in readings] == []
            readings = gripper.subscribe()
            simulator.close()
            with pytest.raises(NotConnectedError):
                async for _ in readings:
                    pass

    asyncio.run(asyncio.wait_for(program(), 60))


def test_stream_yields_new_samples_until_its_end(wsg_sim: Simulator) -> None:
    host, port = wsg_sim.tcp.removeprefix("tcp://").split(":")
    with WSGController(None, host, int(port)) as gripper:
        closed, samples = gripper.subscribe(), gripper.subscribe()
        numbers = [sample.number for sample in islice(samples, 20)]
        assert numbers == sorted(set(numbers))
        closed.close()
        with pytest.raises(StopIteration):
            next(closed)
        gripper.fast_stop()
        with pytest.raises(StreamEndedError, match="FAST STOP|more than 1 s"):
            deque(samples, 0)
