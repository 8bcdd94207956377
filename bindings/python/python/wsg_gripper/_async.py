"""The driver for asyncio."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Awaitable, Coroutine, Generator
from types import TracebackType
from typing import TYPE_CHECKING, Any, Callable, Optional, TypeVar, cast

from ._gripper import Gripper
from ._native import Driver, Ticket
from ._types import Reading
from ._updates import Subscription, reading

if TYPE_CHECKING:
    from typing_extensions import Concatenate, ParamSpec

    P = ParamSpec("P")

T = TypeVar("T")
U = TypeVar("U")
Self = TypeVar("Self", bound="AsyncGripper")


def _settle(future: asyncio.Future[Any], value: Any, error: Optional[BaseException]) -> None:
    if future.done():
        return
    if error is None:
        future.set_result(value)
    else:
        future.set_exception(error)


async def _ask(method: Callable[..., object], *arguments: object) -> Any:
    """Make a request in the thread of the driver. Stop a motion if this task is cancelled."""
    loop = asyncio.get_running_loop()
    future: asyncio.Future[Any] = loop.create_future()

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


class _Requests:
    """The requests of a driver as coroutines."""

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        self.is_gcl = driver.is_gcl

    def __getattr__(self, name: str) -> Callable[..., Coroutine[Any, Any, Any]]:
        return functools.partial(_ask, getattr(self._driver, name))


def _asynchronous(
    method: Callable[Concatenate[Gripper, P], T],
) -> Callable[Concatenate[AsyncGripper, P], Coroutine[Any, Any, T]]:
    """Return a method of ``Gripper`` as a coroutine. It uses only ``_core`` and ``_then``, which await here."""

    async def call(gripper: AsyncGripper, /, *arguments: P.args, **named: P.kwargs) -> T:
        return await cast(Awaitable[T], method(cast(Any, gripper), *arguments, **named))

    functools.update_wrapper(call, method)
    call.__qualname__ = f"AsyncGripper.{method.__name__}"
    return call


class AsyncSubscription:
    """Like :class:`Subscription`, with ``async with`` and ``async for``."""

    def __init__(self, subscription: Subscription[Reading]) -> None:
        self._subscription = subscription

    async def __aenter__(self) -> AsyncSubscription:
        return self

    async def __aexit__(
        self,
        kind: Optional[type[BaseException]],
        error: Optional[BaseException],
        traceback: Optional[TracebackType],
    ) -> None:
        await self.close()

    def __aiter__(self) -> AsyncSubscription:
        return self

    async def __anext__(self) -> Reading:
        reading = await asyncio.get_running_loop().run_in_executor(None, next, self._subscription, None)
        if reading is None:
            raise StopAsyncIteration
        return reading

    async def close(self) -> None:
        """Like ``Subscription.close``."""
        await asyncio.get_running_loop().run_in_executor(None, self._subscription.close)


class AsyncGripper:
    """A connection to a gripper for asyncio, with the methods of ``Gripper``.

    ::

        async with AsyncGripper("tcp://192.168.1.20") as gripper:
            await gripper.home()
            grip = asyncio.create_task(gripper.grip(20, speed=100))
            while not grip.done():
                print(await gripper.width())
            print(await grip)

    Requests of other tasks pass a motion, but another motion waits for it. The cancellation of a motion, by
    ``asyncio.wait_for`` for example, stops the fingers. A cancelled query has no effect. A stop, also by a cancellation,
    withdraws the motions and acknowledgements that wait: they raise :class:`StoppedError`. The line is served by threads
    without the interpreter lock, so the event loop never waits for the gripper.

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
    def _core(self) -> _Requests:
        return _Requests(self._connected())

    def _connected(self) -> Driver:
        if self._driver is None:
            raise RuntimeError("not connected: use `async with AsyncGripper(address)` or `await AsyncGripper(address)`")
        return self._driver

    @staticmethod
    async def _then(value: Awaitable[T], convert: Callable[[T], U]) -> U:
        return convert(await value)

    # Motions

    home = _asynchronous(Gripper.home)
    move = _asynchronous(Gripper.move)
    move_by = _asynchronous(Gripper.move_by)
    grip = _asynchronous(Gripper.grip)
    release = _asynchronous(Gripper.release)
    stop = _asynchronous(Gripper.stop)
    fast_stop = _asynchronous(Gripper.fast_stop)
    acknowledge = _asynchronous(Gripper.acknowledge)

    # Settings

    acceleration = _asynchronous(Gripper.acceleration)
    set_acceleration = _asynchronous(Gripper.set_acceleration)
    force_limit = _asynchronous(Gripper.force_limit)
    set_force_limit = _asynchronous(Gripper.set_force_limit)
    soft_limits = _asynchronous(Gripper.soft_limits)
    set_soft_limits = _asynchronous(Gripper.set_soft_limits)
    clear_soft_limits = _asynchronous(Gripper.clear_soft_limits)
    set_overdrive = _asynchronous(Gripper.set_overdrive)
    tare = _asynchronous(Gripper.tare)
    part_width_tolerance = _asynchronous(Gripper.part_width_tolerance)
    set_part_width_tolerance = _asynchronous(Gripper.set_part_width_tolerance)
    clamping_travel = _asynchronous(Gripper.clamping_travel)
    set_clamping_travel = _asynchronous(Gripper.set_clamping_travel)

    # State

    flags = _asynchronous(Gripper.flags)
    state = _asynchronous(Gripper.state)
    statistics = _asynchronous(Gripper.statistics)
    width = _asynchronous(Gripper.width)
    speed = _asynchronous(Gripper.speed)
    force = _asynchronous(Gripper.force)
    temperature = _asynchronous(Gripper.temperature)

    def subscribe(
        self,
        interval: Optional[float] = None,
        *,
        width: bool = True,
        speed: bool = True,
        force: bool = True,
    ) -> AsyncSubscription:
        """Like ``Gripper.subscribe``, with ``async with`` and ``async for``."""
        return AsyncSubscription(Subscription(self._connected().subscribe(interval, width, speed, force), reading))

    # Device

    info = _asynchronous(Gripper.info)
    limits = _asynchronous(Gripper.limits)
    tag = _asynchronous(Gripper.tag)
    set_tag = _asynchronous(Gripper.set_tag)

    # Fingers

    finger_info = _asynchronous(Gripper.finger_info)
    finger_flags = _asynchronous(Gripper.finger_flags)
    set_finger_power = _asynchronous(Gripper.set_finger_power)
    finger_data = _asynchronous(Gripper.finger_data)

    # Connection

    loop_back = _asynchronous(Gripper.loop_back)
    raw = _asynchronous(Gripper.raw)
