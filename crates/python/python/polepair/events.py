"""Events of a link: values that drives send by themselves, faults,
restarts, a cable that was pulled.

>>> import polepair
>>> with polepair.connect("sim:cia402:2?time=virtual") as link:
...     with link.events() as events:
...         link.simulation.act("fault", 0x2310)
...         for event in events:
...             if isinstance(event, FaultAppeared):
...                 break
>>> event.axis, event.code == 0x2310
(2, True)
"""

from __future__ import annotations

import sys
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from typing import Any, Union

from . import _polepair as native
from ._axis import ELSEWHERE
from ._records import Fault
from ._steps import Call, Steps, Wait, run

__all__ = [
    "ArmedChanged",
    "AsyncEvents",
    "Events",
    "FaultAppeared",
    "FaultCleared",
    "Happening",
    "LinkBack",
    "LinkLost",
    "ParameterSent",
    "PresenceChanged",
    "SignalSent",
    "Subscription",
]


@dataclass(frozen=True, slots=True)
class SignalSent:
    """A drive sent a signal's value; of a flag or a code, when it changed."""

    time: float
    """Seconds on the link's clock, when it arrived."""
    axis: int
    """The axis' number."""
    signal: str
    """`position`, `velocity`, `fault` and so on."""
    value: float
    """In SI; NaN while a setting that the scale depends on was never read."""
    raw: int
    """Raw number of the drive."""


@dataclass(frozen=True, slots=True)
class ParameterSent:
    """A drive sent the value of a parameter that is no signal."""

    time: float
    axis: int
    name: str
    """The parameter's name."""
    value: float
    """In `unit`."""
    unit: str
    raw: int
    """Raw number of the drive."""


@dataclass(frozen=True, slots=True)
class FaultAppeared:
    """A drive now has a fault."""

    time: float
    axis: int
    code: int
    """The drive's code, or the bit of its fault word."""
    fault: Fault | None
    """Name, cause and remedy, where the profile knows it."""


@dataclass(frozen=True, slots=True)
class FaultCleared:
    """A drive has a fault no more."""

    time: float
    axis: int
    code: int
    fault: Fault | None


@dataclass(frozen=True, slots=True)
class PresenceChanged:
    """A new network state of a drive."""

    time: float
    axis: int
    presence: str
    """`restarted`, `preparing`, `operating`, `halted` or `gone`; the first and last disarm."""


@dataclass(frozen=True, slots=True)
class ArmedChanged:
    """Motion commands are let through from now on, or no longer."""

    time: float
    axis: int
    armed: bool


@dataclass(frozen=True, slots=True)
class LinkLost:
    """The link was lost. It is tried again."""

    time: float
    reason: str


@dataclass(frozen=True, slots=True)
class LinkBack:
    """The link is there again."""

    time: float


Happening = Union[
    SignalSent,
    ParameterSent,
    FaultAppeared,
    FaultCleared,
    PresenceChanged,
    ArmedChanged,
    LinkLost,
    LinkBack,
]
"""One thing that happened."""


Told = tuple[
    float,
    "int | None",
    str,
    str,
    float,
    int,
    str,
    "tuple[int, str, str, str, str, bool] | None",
]
"""Time, axis, sort, name, value, raw value, unit, fault, as the native half has them."""


def _happening(told: Told) -> Happening | None:
    time, axis, sort, name, value, raw, unit, of_fault = told
    if axis is None:
        return LinkLost(time, name) if sort == "link lost" else LinkBack(time)
    fault = None if of_fault is None else Fault(*of_fault)
    if sort == "signal":
        return SignalSent(time, axis, name, value, raw)
    if sort == "parameter":
        return ParameterSent(time, axis, name, value, unit, raw)
    if sort == "fault appeared":
        return FaultAppeared(time, axis, raw, fault)
    if sort == "fault cleared":
        return FaultCleared(time, axis, raw, fault)
    if sort == "presence":
        return PresenceChanged(time, axis, name)
    if sort in ("armed", "disarmed"):
        return ArmedChanged(time, axis, sort == "armed")
    return None


class _Events:
    """Events from the creation of this object until it is closed. It keeps the link open."""

    __slots__ = ("__weakref__", "_native")

    def __init__(self, events: native.Events) -> None:
        self._native = events

    @property
    def lost(self) -> int:
        """Events that were dropped because they were not read in time."""
        return self._native.lost

    @property
    def closed(self) -> bool:
        """True once it is closed."""
        return self._native.closed

    def close(self) -> None:
        """Listens no more, and ends a wait under way; a loop over the events ends."""
        self._native.close()

    def _next(self, timeout: float | None = None) -> Steps[Happening | None]:
        """Waits for the next event, at most `timeout` seconds of the link's time.

        None when there was none, and once this is closed.
        """
        while not self._native.closed:
            if self._native.in_virtual_time:
                # Simulated time passes only during waits, here one second at most at once.
                slice_s = 1.0 if timeout is None else timeout
                told = yield Call(self._native.result, slice_s)
            else:
                told = yield Wait(self._native, timeout)
            happening = None if told is None else _happening(told)
            if happening is not None or timeout is not None:
                return happening
        return None

    def __reduce__(self) -> tuple[Any, ...]:
        raise TypeError(f"events cannot be pickled: {ELSEWHERE}")

    def __repr__(self) -> str:
        return "<Events, closed>" if self.closed else f"<Events, {self.lost} lost>"


class Events(_Events, Iterator[Happening]):
    """Events for a thread: `for event in link.events()`. The loop ends when this is closed."""

    __slots__ = ()

    def next(self, timeout: float | None = None) -> Happening | None:
        """Waits for the next event, at most `timeout` seconds; None when there was none."""
        return run(self._next(timeout))

    def __iter__(self) -> Events:
        return self

    def __next__(self) -> Happening:
        happening = run(self._next())
        if happening is None:
            raise StopIteration
        return happening

    def __enter__(self) -> Events:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class AsyncEvents(_Events, AsyncIterator[Happening]):
    """Events for an event loop: `async for event in await link.events()`."""

    __slots__ = ()

    async def next(self, timeout: float | None = None) -> Happening | None:
        """Waits for the next event, at most `timeout` seconds; None when there was none."""
        from .aio import arun

        return await arun(self._next(timeout))

    def __aiter__(self) -> AsyncEvents:
        return self

    async def __anext__(self) -> Happening:
        happening = await self.next()
        if happening is None:
            raise StopAsyncIteration
        return happening

    async def __aenter__(self) -> AsyncEvents:
        return self

    async def __aexit__(self, *error: object) -> None:
        self.close()


class Subscription:
    """A function that is called with each event, in a thread of its own, until `end`.

    Exceptions of the function are reported as for any thread (`threading.excepthook`), and the next event is
    still delivered.
    """

    __slots__ = ("_events", "_function", "_thread")

    def __init__(self, events: Events, function: Callable[[Happening], object]) -> None:
        self._events = events
        self._function = function
        self._thread = threading.Thread(target=self._tell, name="polepair-events", daemon=True)
        self._thread.start()

    def _tell(self) -> None:
        for event in self._events:
            try:
                self._function(event)
            except Exception:
                told = (*sys.exc_info(), threading.current_thread())
                threading.excepthook(threading.ExceptHookArgs(told))

    def __repr__(self) -> str:
        return f"<Subscription of {self._function!r}: {self.lost} events lost>"

    @property
    def lost(self) -> int:
        """Events that were discarded so far because the function took too long."""
        return self._events.lost

    def end(self) -> None:
        """Calls it no more: not after this returns, unless it is called by the function itself."""
        self._events.close()
        if self._thread is not threading.current_thread():
            self._thread.join()

    def __enter__(self) -> Subscription:
        return self

    def __exit__(self, *error: object) -> None:
        self.end()
