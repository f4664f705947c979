"""Links and axes for programs with an event loop: methods that wait are awaited.

>>> import asyncio, polepair
>>> async def main() -> float:
...     async with polepair.aio.connect("sim:tmcl?time=virtual") as link:
...         axis = link.axes[0]
...         async with axis.armed():
...             motion = await axis.move(90, "deg")
...             await motion.wait()
...         return (await axis.read("position"))["position"]
>>> round(asyncio.run(main()), 2)
1.57
"""

from __future__ import annotations

import asyncio
import functools
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Generator
from os import PathLike, getpid
from types import TracebackType
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar

from . import _polepair as native
from ._axis import TIMEOUT, Asked, AxisSteps, Settings
from ._group import GroupSteps, Targets
from ._link import ArmedOf, LinkOf, ParametersOf, not_stopped, opened
from ._records import Fault
from ._steps import Call, Steps, Urgent, Wait, Whole, next_row
from ._sync import Row
from .errors import PolepairError
from .paths import PathSteps
from .quantity import Amount, PositionUnit, Quantity, Signal

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

    from .events import AsyncEvents, Happening, Subscription

__all__ = [
    "Armed",
    "Axis",
    "Group",
    "GroupMotion",
    "Link",
    "Motion",
    "Opening",
    "Parameters",
    "Watch",
    "connect",
]

P = ParamSpec("P")
R = TypeVar("R")
S = TypeVar("S")


async def arun(steps: Steps[R]) -> R:
    """Carries steps out in the event loop that runs."""
    try:
        step = next(steps)
        while True:
            try:
                if isinstance(step, Wait):
                    answer = await _ended(step)
                else:
                    answer = await _called(step)
            except BaseException as error:
                step = steps.throw(error)
            else:
                step = steps.send(answer)
    except StopIteration as end:
        return end.value  # type: ignore[no-any-return]


async def _called(call: Call) -> Any:
    loop = asyncio.get_running_loop()
    threads = _stopping() if isinstance(call, Urgent) else None
    called = loop.run_in_executor(threads, call.function, *call.arguments)
    return await (_whole(called) if isinstance(call, Whole) else called)


_stoppers: dict[int, ThreadPoolExecutor] = {}


def _stopping() -> ThreadPoolExecutor:
    """Threads for stops alone: the loop's own may all wait for answers. A fork's child has others."""
    from concurrent.futures import ThreadPoolExecutor

    process = getpid()
    if process not in _stoppers:
        _stoppers[process] = ThreadPoolExecutor(STOPPING, "polepair-stop")
    return _stoppers[process]


async def _whole(future: asyncio.Future[R]) -> R:
    """Returns the result. A cancellation takes effect when the request has ended."""
    cancelled: asyncio.CancelledError | None = None
    while not future.done():
        try:
            await asyncio.wait([future])
        except asyncio.CancelledError as error:
            cancelled = error
    if cancelled is not None:
        if not future.cancelled():
            future.exception()
        raise cancelled
    return future.result()


class _Waiting:
    """The waiter for one request in one event loop; only the last registered waiter is woken."""

    __slots__ = ("count", "ended")

    def __init__(self, ended: asyncio.Future[None]) -> None:
        self.ended = ended
        self.count = 0


_waiting: dict[tuple[asyncio.AbstractEventLoop, object], _Waiting] = {}


async def _ended(step: Wait) -> Any:
    loop = asyncio.get_running_loop()
    key = (loop, step.request)
    waiting = _waiting.get(key)
    is_first = waiting is None or waiting.ended.done()
    if waiting is None or is_first:
        waiting = _waiting[key] = _Waiting(loop.create_future())
    ended = waiting.ended

    def tell() -> None:
        loop.call_soon_threadsafe(_settle, ended)

    waiting.count += 1
    try:
        if is_first and step.request.tell(tell):
            _settle(ended)
        if not ended.done():
            await asyncio.wait([ended], timeout=step.timeout)
    finally:
        waiting.count -= 1
        if not waiting.count and _waiting.get(key) is waiting:
            del _waiting[key]
    return step.request.result(0)


def _settle(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


def awaitable(
    steps: Callable[Concatenate[S, P], Steps[R]],
) -> Callable[Concatenate[S, P], Awaitable[R]]:
    """The method that carries the steps out in the caller's event loop."""

    @functools.wraps(steps)
    async def method(self: S, /, *args: P.args, **kwargs: P.kwargs) -> R:
        return await arun(steps(self, *args, **kwargs))

    return method


STOPPING = 64
"""Stops that are on their way at once."""

TURNS = 48
"""Requests of a link that are under way at once; further ones wait for their turn."""


class Axis(AxisSteps):
    """One motor."""

    __slots__ = ("_turns",)

    def __init__(
        self, axis: native.Axis, turns: asyncio.Semaphore
    ) -> None:
        super().__init__(axis)
        self._turns = turns

    async def _in_turn(self, steps: Steps[R]) -> R:
        async with self._turns:
            return await arun(steps)

    @property
    def params(self) -> Parameters:
        """The parameters by name: `await axis.params.set("max current", 1.2)`."""
        return Parameters(self)

    @property
    def paths(self) -> Paths:
        """Paths that the drive stores (SYNTRON TS): `await axis.paths.run(1)`."""
        return Paths(self)

    enable = awaitable(AxisSteps._enable)
    disable = awaitable(AxisSteps._disable)
    stop = awaitable(AxisSteps._stop)
    quick_stop = awaitable(AxisSteps._quick_stop)
    clear = awaitable(AxisSteps._clear)
    spin = awaitable(AxisSteps._spin)
    torque = awaitable(AxisSteps._press)
    home = awaitable(AxisSteps._home)
    reached = awaitable(AxisSteps._reached)
    capture = awaitable(AxisSteps._capture)
    record_in_drive = awaitable(AxisSteps._record_in_drive)
    couple = awaitable(AxisSteps._couple)
    uncouple = awaitable(AxisSteps._uncouple)
    state = awaitable(AxisSteps._state)
    step = awaitable(AxisSteps._step)

    async def read(self, *signals: Signal | str) -> dict[str, float]:
        """Reads signals now, in SI: rad (m), rad/s, N·m, A, V; temperatures in degC.

        Any other name is a parameter, or an address such as `0x2030:1:u16`, in the parameter's unit.
        """
        return await self._in_turn(self._read(*signals))

    async def read_text(self, name: str) -> str:
        """Reads a parameter that holds text, such as `1008h` of CANopen, by name or address."""
        return await self._in_turn(self._read_text(name))

    async def read_bytes(self, name: str) -> bytes:
        """Reads a parameter that holds bytes, such as a domain of CANopen, by name or address."""
        return await self._in_turn(self._read_bytes(name))

    async def write_bytes(self, name: str, data: bytes) -> None:
        """Writes all bytes of a parameter by name or address, by block transfer if the drive supports it.

        It is not repeated after a lost reply, because the drive may have stored a part.
        """
        await self._in_turn(self._write_bytes(name, data))

    async def raw(self, said: str | bytes, *, id: int | None = None) -> int:
        """Sends a request as text or bytes of the protocol, and returns the value of the reply."""
        return await self._in_turn(self._raw(said, id))

    async def events(self) -> AsyncEvents:
        """Events of this axis and its link: `async for event in await axis.events()`."""
        from .events import AsyncEvents

        loop = asyncio.get_running_loop()
        return AsyncEvents(await loop.run_in_executor(None, self._native.events))

    async def faults(self) -> list[Fault]:
        """Active faults and warnings, with cause and remedy."""
        return await self._in_turn(self._faults())

    async def move(
        self,
        target: Amount,
        unit: PositionUnit | None = None,
        *,
        velocity: Amount | None = None,
        acceleration: Amount | None = None,
        deceleration: Amount | None = None,
    ) -> Motion:
        """rad (m) or with a unit: starts a move to a position. The axis must be armed."""
        await arun(self._set_out("move-to", target, unit, velocity, acceleration, deceleration))
        return Motion(self)

    async def move_by(
        self,
        distance: Amount,
        unit: PositionUnit | None = None,
        *,
        velocity: Amount | None = None,
        acceleration: Amount | None = None,
        deceleration: Amount | None = None,
    ) -> Motion:
        """rad (m) or with a unit: starts a move by a distance from the actual position. Never sent twice."""
        await arun(self._set_out("move-by", distance, unit, velocity, acceleration, deceleration))
        return Motion(self)

    def armed(self, watchdog: float | None = None) -> Armed:
        """Lets it move within an `async with` block, whose end stops and disables it."""
        return Armed(self, watchdog)

    def watch(self, *signals: Signal | str, period: float = 0.1) -> Watch:
        """Reads signals periodically: seconds since the start, and values in SI.

        A server sends them by itself; `lost` of the result counts missing samples.
        """
        if self._native.is_remote:
            return Watch(self._told(self._native, signals, period))
        return Watch(self._polled(signals, period))

    async def _told(
        self, axis: native.Axis, signals: tuple[str, ...], period: float
    ) -> AsyncGenerator[Row | native.SampleStream, None]:
        loop = asyncio.get_running_loop()
        stream = await loop.run_in_executor(None, axis.watch, list(signals), period)
        yield stream
        began: float | None = None
        while True:
            row = await arun(next_row(stream, self.label))
            if row is None:
                return
            time, values = row
            began = time if began is None else began
            yield time - began, dict(zip(signals, values, strict=True))

    async def _polled(
        self, signals: tuple[str, ...], period: float
    ) -> AsyncGenerator[Row, None]:
        began = self._native.now
        while True:
            now = self._native.now
            yield now - began, await self.read(*signals)
            await asyncio.sleep(max(0.0, period - (self._native.now - now)))


class Watch(AsyncIterator[Row]):
    """A subscription to signals: iterates over rows of time and values."""

    __slots__ = ("_rows", "_stream")

    def __init__(self, rows: AsyncGenerator[Row | native.SampleStream, None]) -> None:
        self._rows = rows
        self._stream: native.SampleStream | None = None

    async def __anext__(self) -> Row:
        row = await anext(self._rows)
        if isinstance(row, native.SampleStream):
            self._stream = row
            return await self.__anext__()
        return row

    def __repr__(self) -> str:
        return f"<Watch: {self.lost} samples lost>"

    @property
    def lost(self) -> int:
        """Missing samples of the signal that lost most."""
        return 0 if self._stream is None else self._stream.lost

    async def aclose(self) -> None:
        """Ends the subscription."""
        await self._rows.aclose()
        self._stream = None


class Motion:
    """A move under way; awaiting it waits until it has arrived."""

    __slots__ = ("_asked", "_axis")

    def __init__(self, axis: Axis) -> None:
        self._axis = axis
        self._asked: Asked = []

    async def wait(self, timeout: float = TIMEOUT) -> None:
        """Waits until the axis has arrived. Errors: `PolepairError` E101 after the time limit."""
        await arun(self._axis._arrive(timeout, self._asked))

    async def done(self) -> bool:
        """True if the axis has arrived."""
        return await arun(self._axis._done(self._asked))

    def __await__(self) -> Generator[None, None, None]:
        return self.wait().__await__()

    async def cancel(self) -> None:
        """Stops the axis."""
        await self._axis.stop()

    def __repr__(self) -> str:
        return f"<Motion of {self._axis.label}>"


class Group(GroupSteps[Axis]):
    """Axes of a link that move together."""

    __slots__ = ()

    stop = awaitable(GroupSteps._stop)

    async def move(
        self,
        targets: Targets,
        unit: PositionUnit | None = None,
        *,
        velocity: Amount | None = None,
        acceleration: Amount | None = None,
        sync: bool = True,
    ) -> GroupMotion:
        """rad (m) or with a unit: starts a move of each axis. With `sync` one message on the bus starts all."""
        moves = self._set_out("move-to", targets, unit, velocity, acceleration, sync)
        return GroupMotion(self, await arun(moves))

    async def move_by(
        self,
        distances: Targets,
        unit: PositionUnit | None = None,
        *,
        velocity: Amount | None = None,
        acceleration: Amount | None = None,
        sync: bool = True,
    ) -> GroupMotion:
        """rad (m) or with a unit: starts moves by distances from the actual positions. Never sent twice."""
        moves = self._set_out("move-by", distances, unit, velocity, acceleration, sync)
        return GroupMotion(self, await arun(moves))

    def armed(self, watchdog: float | None = None) -> GroupArmed:
        """Lets them move within an `async with` block, whose end stops and disables all."""
        return GroupArmed(self, watchdog)


class GroupMotion:
    """Moves of several axes under way; awaiting it waits until all have arrived."""

    __slots__ = ("_group", "_moving")

    def __init__(self, group: Group, moving: list[Axis]) -> None:
        self._group = group
        self._moving = moving

    async def wait(self, timeout: float = TIMEOUT) -> None:
        """Waits until all axes have arrived. Errors: `PolepairError` E101 after the time limit."""
        await arun(self._group._arrive(self._moving, timeout))

    def __await__(self) -> Generator[None, None, None]:
        return self.wait().__await__()

    async def cancel(self) -> None:
        """Stops the group."""
        await self._group.stop()

    def __repr__(self) -> str:
        return f"<Motion of {', '.join(axis.label for axis in self._moving)}>"


class GroupArmed:
    """Axes that may move, for as long as an `async with` block lasts."""

    __slots__ = ("_before", "_group", "_watchdog")

    def __init__(self, group: Group, watchdog: float | None) -> None:
        self._group = group
        self._watchdog = watchdog
        self._before: list[Settings] = []

    def __repr__(self) -> str:
        return f"<Armed group of {', '.join(axis.label for axis in self._group.axes)}>"

    async def __aenter__(self) -> Group:
        self._before = await arun(self._group._arm(self._watchdog))
        return self._group

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await _released(self._group._release(self._before), error)


class Armed(ArmedOf[Axis]):
    """An axis that may move, for as long as an `async with` block lasts."""

    __slots__ = ()

    async def __aenter__(self) -> Axis:
        self._before = await arun(self._axis._arm(self._watchdog))
        return self._axis

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await _released(self._axis._release(self._before), error)


async def _released(steps: Steps[None], error: BaseException | None) -> None:
    """Stops and disables the axis, also after an exception."""
    # A task that is cancelled must not leave a motor running.
    release = asyncio.ensure_future(arun(steps))
    try:
        await _whole(release)
    except asyncio.CancelledError as cancelled:
        if not release.cancelled() and isinstance(failed := release.exception(), PolepairError):
            not_stopped(failed, cancelled)
        raise
    except PolepairError as failed:
        not_stopped(failed, error)


class Parameters(ParametersOf[Axis]):
    """Parameters of a drive by name, in their units."""

    __slots__ = ()

    async def get(self, name: str) -> Quantity:
        """Reads a parameter, in its unit."""
        return await self._axis._in_turn(self._axis._get(name))

    async def get_raw(self, name: str) -> int:
        """Reads a parameter as the raw number of the drive."""
        return await self._axis._in_turn(self._axis._get_raw(name))

    async def set(self, name: str, amount: Amount, *, keep: bool = False) -> None:
        """Writes a parameter: a number in its own unit, `"1200 mA"`, or one of its words."""
        await self._axis._in_turn(self._axis._set(name, amount, keep=keep))

    async def set_raw(self, name: str, raw: int, *, keep: bool = False) -> None:
        """Writes a parameter as the raw number of the drive."""
        await self._axis._in_turn(self._axis._set_raw(name, raw, keep=keep))


class Paths(PathSteps):
    """The paths that a drive stores: those of the SYNTRON TS."""

    __slots__ = ()

    read = awaitable(PathSteps._read)
    write = awaitable(PathSteps._write)
    run = awaitable(PathSteps._run)
    start = awaitable(PathSteps._start)


class Link(LinkOf[Axis]):
    """An open link and its axes; an `async with` block closes it."""

    __slots__ = ("_turns",)

    def __init__(self, link: native.Link) -> None:
        self._turns = asyncio.Semaphore(TURNS)
        super().__init__(link)

    def _axis(self, axis: native.Axis) -> Axis:
        return Axis(axis, self._turns)

    def group(self, *which: int | str) -> Group:
        """A group of axes by number or name; without arguments, all axes."""
        return Group(self._chosen(which))

    async def events(self) -> AsyncEvents:
        """Events of all wires and axes: `async for event in await link.events()`."""
        from .events import AsyncEvents

        loop = asyncio.get_running_loop()
        return self._heard(
            AsyncEvents(await loop.run_in_executor(None, self._open().events))
        )

    def on_event(self, function: Callable[[Happening], object]) -> Subscription:
        """Calls a function in this event loop with each event, until `end` of the result.

        Exceptions of the function go to the loop's exception handler.
        """
        loop = asyncio.get_running_loop()

        def tell(event: Happening) -> None:
            loop.call_soon_threadsafe(function, event)

        return self._subscribed(tell)

    async def stop(self) -> None:
        """Stops all axes. All stops are sent before the first confirmation is awaited."""
        loop = asyncio.get_running_loop()
        await loop.run_in_executor(_stopping(), self._open().stop_all)

    async def __aenter__(self) -> Link:
        self._open()
        return self

    async def __aexit__(self, *error: object) -> None:
        await self._closed()

    async def _closed(self) -> None:
        """Closes it; a slow stop does not block the event loop."""
        try:
            if self._native is not None and self._process == getpid():
                loop = asyncio.get_running_loop()
                await _whole(loop.run_in_executor(_stopping(), self._native.stop_armed))
        finally:
            self.close()


def _known(
    open_it: Callable[[], native.Link],
) -> native.Link:
    """Opens a link, and reads the parameters of a server's axes, which the loop must not wait for."""
    link = open_it()
    if link.is_remote:
        for axis in link.axes():
            axis.parameters()
    return link


class Opening:
    """A link on its way: awaited, or entered as it is."""

    __slots__ = ("_link", "_open_it")

    def __init__(self, open_it: Callable[[], native.Link]) -> None:
        self._open_it = open_it
        self._link: Link | None = None

    def __repr__(self) -> str:
        return "<Opening of a link>" if self._link is None else f"<Opening of {self._link!r}>"

    async def _open(self) -> Link:
        loop = asyncio.get_running_loop()
        return Link(await loop.run_in_executor(None, _known, self._open_it))

    def __await__(self) -> Generator[Any, None, Link]:
        return self._open().__await__()

    async def __aenter__(self) -> Link:
        self._link = await self._open()
        return self._link

    async def __aexit__(self, *error: object) -> None:
        if self._link is not None:
            await self._link._closed()


def connect(
    url: str,
    *,
    profile: str | PathLike[str] | None = None,
    token_file: str | PathLike[str] | None = None,
    certificate: str | PathLike[str] | None = None,
    client_cert: str | PathLike[str] | None = None,
    client_key: str | PathLike[str] | None = None,
) -> Opening:
    """Opens a link or joins a server, as `polepair.connect` does: `await` it, or `async with` it."""
    pinned = (token_file, certificate, client_cert, client_key)
    return Opening(functools.partial(opened, url, profile, False, *pinned))
