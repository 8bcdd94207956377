"""The driver for asyncio."""

from __future__ import annotations

import asyncio
from collections.abc import Generator
from types import TracebackType
from typing import Any, Callable, Optional, TypeVar, cast

from ._gripper import grip_result, require_gcl, soft_limits
from ._native import Driver, Ticket
from ._types import (
    FingerFlags,
    FingerInfo,
    GripperState,
    GripResult,
    HomingDirection,
    Limits,
    SoftLimits,
    Statistics,
    SystemFlags,
    SystemInfo,
)

T = TypeVar("T")
Self = TypeVar("Self", bound="AsyncGripper")


def _settle(future: asyncio.Future[Any], value: Any, error: Optional[BaseException]) -> None:
    if future.done():
        return
    if error is None:
        future.set_result(value)
    else:
        future.set_exception(error)


class AsyncGripper:
    """A connection to a gripper for asyncio, with the methods of ``Gripper``.

    ::

        async with AsyncGripper("tcp://192.168.1.20") as gripper:
            await gripper.home()
            grip = asyncio.create_task(gripper.grip(20, speed=100))
            while not grip.done():
                print(await gripper.width())
            print(await grip)

    Requests of other tasks pass a motion. The cancellation of a motion, by ``asyncio.wait_for`` for example, stops the
    fingers. A cancelled query has no effect. The line is served by threads without the interpreter lock, so the event loop
    never waits for the gripper.

    ``await AsyncGripper(address)`` connects outside of ``async with``; call :meth:`close` at the end.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self._driver: Optional[Driver] = None

    async def _connect(self: Self) -> Self:
        if self._driver is None:
            self._driver = await asyncio.get_running_loop().run_in_executor(None, Driver, self.address)
        return self

    def __await__(self: Self) -> Generator[Any, None, Self]:
        return self._connect().__await__()

    async def __aenter__(self: Self) -> Self:
        return await self._connect()

    async def __aexit__(
        self,
        kind: Optional[type[BaseException]],
        error: Optional[BaseException],
        traceback: Optional[TracebackType],
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Like ``Gripper.close``."""
        if self._driver is not None:
            await asyncio.get_running_loop().run_in_executor(None, self._driver.close)

    @property
    def is_open(self) -> bool:
        """Whether there is a connection that has not been closed."""
        return self._driver is not None and self._driver.is_open()

    @property
    def _core(self) -> Driver:
        if self._driver is None:
            raise RuntimeError("not connected: use `async with AsyncGripper(address)` or `await AsyncGripper(address)`")
        return self._driver

    async def _ask(self, method: Callable[..., T], *arguments: object) -> T:
        """Make a request in the thread of the driver. Stop a motion if this task is cancelled."""
        loop = asyncio.get_running_loop()
        future: asyncio.Future[T] = loop.create_future()

        def reply(value: Any, error: Optional[BaseException]) -> None:
            try:
                loop.call_soon_threadsafe(_settle, future, value, error)
            except RuntimeError:
                pass  # The loop is closed.

        ticket = cast(Ticket, method(*arguments, reply=reply))
        try:
            return await future
        except asyncio.CancelledError:
            ticket.cancel()
            raise

    # Motions

    async def home(self, direction: HomingDirection = HomingDirection.DEFAULT) -> None:
        """Like ``Gripper.home``."""
        await self._ask(self._core.home, direction, True)

    async def move(self, width: float, speed: float, *, clamp: bool = False) -> None:
        """Like ``Gripper.move``."""
        await self._ask(self._core.move_to, width, speed, clamp, True)

    async def move_by(self, offset: float, speed: float, *, clamp: bool = False) -> None:
        """Like ``Gripper.move_by``."""
        await self._ask(self._core.move_by, offset, speed, clamp, True)

    async def grip(self, width: float, speed: float, force: Optional[float] = None) -> GripResult:
        """Like ``Gripper.grip``."""
        return grip_result(cast(bool, await self._ask(self._core.grip, width, speed, force, True)))

    async def release(self, width: float, speed: float) -> None:
        """Like ``Gripper.release``."""
        await self._ask(self._core.release, width, speed, True)

    async def stop(self) -> None:
        """Like ``Gripper.stop``: it is sent at once, and a motion of another task raises ``StoppedError``."""
        await self._ask(self._core.stop, False)

    async def fast_stop(self) -> None:
        """Like ``Gripper.fast_stop``."""
        await self._ask(self._core.stop, True)

    async def acknowledge(self) -> None:
        """Like ``Gripper.acknowledge``."""
        await self._ask(self._core.acknowledge)

    # Settings

    async def acceleration(self) -> float:
        """Like ``Gripper.acceleration``."""
        return await self._ask(self._core.acceleration)

    async def set_acceleration(self, acceleration: float) -> None:
        """Like ``Gripper.set_acceleration``."""
        await self._ask(self._core.set_acceleration, acceleration)

    async def force_limit(self) -> float:
        """Like ``Gripper.force_limit``."""
        return await self._ask(self._core.force_limit)

    async def set_force_limit(self, force: float) -> None:
        """Like ``Gripper.set_force_limit``."""
        await self._ask(self._core.set_force_limit, force)

    async def soft_limits(self) -> Optional[SoftLimits]:
        """Like ``Gripper.soft_limits``."""
        return soft_limits(await self._ask(self._core.soft_limits))

    async def set_soft_limits(self, minus: float, plus: float) -> None:
        """Like ``Gripper.set_soft_limits``."""
        await self._ask(self._core.set_soft_limits, minus, plus)

    async def clear_soft_limits(self) -> None:
        """Like ``Gripper.clear_soft_limits``."""
        await self._ask(self._core.clear_soft_limits)

    async def set_overdrive(self, enabled: bool) -> None:
        """Like ``Gripper.set_overdrive``."""
        await self._ask(self._core.set_overdrive, enabled)

    async def tare(self) -> None:
        """Like ``Gripper.tare``."""
        await self._ask(self._core.tare)

    async def part_width_tolerance(self) -> float:
        """Like ``Gripper.part_width_tolerance``."""
        return await self._ask(require_gcl(self._core).part_width_tolerance, None)

    async def set_part_width_tolerance(self, tolerance: float) -> float:
        """Like ``Gripper.set_part_width_tolerance``."""
        return await self._ask(require_gcl(self._core).part_width_tolerance, tolerance)

    async def clamping_travel(self) -> float:
        """Like ``Gripper.clamping_travel``."""
        return await self._ask(require_gcl(self._core).clamping_travel, None)

    async def set_clamping_travel(self, travel: float) -> float:
        """Like ``Gripper.set_clamping_travel``."""
        return await self._ask(require_gcl(self._core).clamping_travel, travel)

    # State

    async def flags(self) -> SystemFlags:
        """Like ``Gripper.flags``."""
        return SystemFlags(await self._ask(self._core.flags))

    async def state(self) -> GripperState:
        """Like ``Gripper.state``."""
        return GripperState(await self._ask(self._core.state))

    async def statistics(self, reset: bool = False) -> Statistics:
        """Like ``Gripper.statistics``."""
        return Statistics(*await self._ask(self._core.statistics, reset))

    async def width(self) -> float:
        """Like ``Gripper.width``."""
        return await self._ask(self._core.width)

    async def speed(self) -> float:
        """Like ``Gripper.speed``."""
        return await self._ask(self._core.speed)

    async def force(self) -> float:
        """Like ``Gripper.force``."""
        return await self._ask(self._core.force)

    async def temperature(self) -> float:
        """Like ``Gripper.temperature``."""
        return await self._ask(self._core.temperature)

    # Device

    async def info(self) -> SystemInfo:
        """Like ``Gripper.info``."""
        return SystemInfo(*await self._ask(self._core.info))

    async def limits(self) -> Limits:
        """Like ``Gripper.limits``."""
        return Limits(*await self._ask(self._core.limits))

    async def tag(self) -> str:
        """Like ``Gripper.tag``."""
        return await self._ask(self._core.tag)

    async def set_tag(self, tag: str) -> None:
        """Like ``Gripper.set_tag``."""
        await self._ask(self._core.set_tag, tag)

    # Fingers

    async def finger_info(self, finger: int) -> FingerInfo:
        """Like ``Gripper.finger_info``."""
        return FingerInfo(*await self._ask(self._core.finger_info, finger))

    async def finger_flags(self, finger: int) -> FingerFlags:
        """Like ``Gripper.finger_flags``."""
        return FingerFlags(await self._ask(self._core.finger_flags, finger))

    async def set_finger_power(self, finger: int, enabled: bool) -> None:
        """Like ``Gripper.set_finger_power``."""
        await self._ask(self._core.set_finger_power, finger, enabled)

    async def finger_data(self, finger: int) -> bytes:
        """Like ``Gripper.finger_data``."""
        return await self._ask(self._core.finger_data, finger)

    # Connection

    async def loop_back(self, data: bytes) -> None:
        """Like ``Gripper.loop_back``."""
        await self._ask(self._core.loop_back, data)

    async def raw(self, command: int, payload: bytes = b"") -> bytes:
        """Like ``Gripper.raw``."""
        return await self._ask(self._core.raw, command, payload)
