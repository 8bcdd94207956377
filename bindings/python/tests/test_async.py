"""The driver for asyncio, against the simulator."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Awaitable, Callable

import pytest
from test_streaming import proxy, wait_for

from wsg_gripper import AsyncGripper, Gripper, GripperState, GripResult, NotConnectedError, StoppedError, SystemFlags
from wsg_gripper.sim import Simulator


def run(program: Callable[[AsyncGripper], Awaitable[None]], simulator: Simulator) -> None:
    async def main() -> None:
        async with AsyncGripper(simulator.tcp) as gripper:
            await gripper.home()
            await program(gripper)

    asyncio.run(main())


async def moving(gripper: AsyncGripper) -> None:
    while SystemFlags.MOVING not in await gripper.flags():
        pass


def test_queries_pass_a_grip(simulator: Simulator) -> None:
    async def program(gripper: AsyncGripper) -> None:
        grip = asyncio.create_task(gripper.grip(20, speed=60, force=30))
        widths = []
        while not grip.done():
            widths.append(await gripper.width())
        assert await grip is GripResult.HELD
        # The last query of a busy machine may be long before the result.
        assert len(set(widths)) > 10
        widths.append(await gripper.width())
        assert len(widths) > 20 and widths[0] > 90 and widths[-1] < 30
        assert await gripper.state() is GripperState.HOLDING

    run(program, simulator)


def test_cancellation_stops_the_fingers(simulator: Simulator) -> None:
    async def program(gripper: AsyncGripper) -> None:
        grip = asyncio.create_task(gripper.grip(20, speed=5))
        await moving(gripper)
        grip.cancel()
        with pytest.raises(asyncio.CancelledError):
            await grip
        while SystemFlags.MOVING in simulator.observe().flags:
            await asyncio.sleep(0)
        assert simulator.observe().width > 100
        # The cancelled grip leaves nothing to the next motions.
        await gripper.move(100, speed=400)
        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(gripper.move(10, speed=5), 0.1)
        await gripper.move(90, speed=400)
        assert await gripper.width() == pytest.approx(90, abs=0.1)

    run(program, simulator)


def test_cancelled_query_does_not_stop_the_fingers(simulator: Simulator) -> None:
    async def program(gripper: AsyncGripper) -> None:
        grip = asyncio.create_task(gripper.grip(20, speed=60))
        await moving(gripper)
        query = asyncio.create_task(gripper.width())
        await asyncio.sleep(0)
        query.cancel()
        assert await grip is GripResult.HELD

    run(program, simulator)


def test_stop_of_another_task_ends_a_grip(simulator: Simulator) -> None:
    async def program(gripper: AsyncGripper) -> None:
        grip = asyncio.create_task(gripper.grip(20, speed=5))
        await moving(gripper)
        await gripper.stop()
        assert SystemFlags.MOVING not in await gripper.flags()
        with pytest.raises(StoppedError):
            await grip

    run(program, simulator)


def test_stop_withdraws_the_requests_that_wait(simulator: Simulator) -> None:
    async def program(gripper: AsyncGripper) -> None:
        moves = [asyncio.create_task(gripper.move(width, speed=5)) for width in (100, 20)]
        await moving(gripper)
        await gripper.stop()
        outcomes = await asyncio.gather(*moves, return_exceptions=True)
        assert [type(outcome) for outcome in outcomes] == [StoppedError, StoppedError]
        assert SystemFlags.MOVING not in await gripper.flags()

    run(program, simulator)


def test_fast_stop_withdraws_an_acknowledgement_that_waits(simulator: Simulator) -> None:
    async def outcome() -> object:
        with proxy(simulator.tcp) as (address, passes):
            async with AsyncGripper(address) as gripper:
                passes.clear()
                # The query waits for its answer and keeps the driver.
                requests = [gripper.width(), gripper.acknowledge(), gripper.fast_stop()]
                tasks = [asyncio.create_task(request) for request in requests]
                await asyncio.sleep(0.1)
                passes.set()
                outcomes = await asyncio.gather(*tasks, return_exceptions=True)
        return outcomes[1]

    def is_withdrawn() -> bool:
        try:
            return isinstance(asyncio.run(outcome()), StoppedError)
        except NotConnectedError:
            # The gripper has not noticed the end of the attempt before.
            return False

    # If the computer pauses, the acknowledgement precedes the stop.
    wait_for(is_withdrawn, 60)
    assert SystemFlags.FAST_STOP in simulator.observe().flags


def test_end_of_the_block_leaves_no_fast_stop(simulator: Simulator) -> None:
    async def program() -> None:
        gripper = await AsyncGripper(simulator.tcp)
        assert gripper.is_open
        await gripper.close()
        assert not gripper.is_open
        with pytest.raises(NotConnectedError):
            await gripper.width()
        with pytest.raises(RuntimeError, match="async with"):
            await AsyncGripper(simulator.tcp).width()

    asyncio.run(program())
    assert SystemFlags.FAST_STOP not in simulator.observe().flags


def test_methods_are_the_methods_of_the_blocking_driver() -> None:
    def signatures(thing: type) -> dict[str, str]:
        return {
            # The results of `subscribe` are iterated over in different ways.
            name: str(inspect.signature(function)).replace("AsyncSubscription", "Subscription[Reading]")
            for name, function in vars(thing).items()
            if inspect.isfunction(function) and not name.startswith(("_", "begin_"))
        }

    assert signatures(AsyncGripper) == signatures(Gripper)


def test_every_request_has_a_result(wsg_sim: Simulator) -> None:
    async def program(gripper: AsyncGripper) -> None:
        await gripper.set_force_limit(30)
        await gripper.set_acceleration(500)
        await gripper.set_soft_limits(10, 90)
        await gripper.set_tag("cell 7")
        assert await gripper.force_limit() == 30
        assert await gripper.acceleration() == 500
        assert await gripper.soft_limits() == (10, 90)
        await gripper.clear_soft_limits()
        assert await gripper.soft_limits() is None
        assert await gripper.tag() == "cell 7"
        assert (await gripper.info()).device == "WSG 50"
        assert (await gripper.limits()).stroke == 110
        assert (await gripper.finger_info(1)).data_len == 0
        await gripper.loop_back(b"any bytes")
        await gripper.move_by(-5, speed=100)
        await gripper.fast_stop()
        await gripper.acknowledge()
        await gripper.release(100, speed=100)
        assert (await gripper.statistics()).total == 0

    run(program, wsg_sim)
