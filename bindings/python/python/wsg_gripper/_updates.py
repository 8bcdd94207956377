"""Subscriptions to the state of a gripper."""

from __future__ import annotations

from typing import Callable, Generic, Optional, Protocol, TypeVar

from ._closing import Closing
from ._types import GripperState, Reading, SystemFlags

T = TypeVar("T")
Row = TypeVar("Row", covariant=True)


class _Source(Protocol[Row]):
    """A native end of a subscription."""

    def next(self) -> Row: ...
    def close(self) -> None: ...


def reading(row: tuple[float, Optional[float], Optional[float], Optional[float], int, int]) -> Reading:
    received, width, speed, force, state, flags = row
    return Reading(received, width, speed, force, GripperState(state), SystemFlags(flags))


class Subscription(Closing, Generic[T]):
    """An iterator over new states of a gripper, returned by ``subscribe``.

    It waits for a new state, and returns none twice. A slow loop gets the newest state. It ends with an exception as soon as
    no more states arrive, and normally after :meth:`close`, which the end of a ``with`` block calls.
    """

    def __init__(self, native: _Source[Row], convert: Callable[[Row], T]) -> None:
        self._native: _Source[Row] = native
        self._convert = convert

    def __iter__(self) -> Subscription[T]:
        return self

    def __next__(self) -> T:
        return self._convert(self._native.next())

    def close(self) -> None:
        """End the subscription. It ends the loop of another thread, too."""
        self._native.close()
