"""Links and axes with blocking methods."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator, Mapping, MutableMapping
from types import TracebackType
from typing import TYPE_CHECKING, TypeAlias

from . import _polepair as native
from ._axis import TIMEOUT, Asked, AxisSteps, Settings
from ._group import GroupSteps, Targets
from ._link import ArmedOf, LinkOf, ParametersOf, not_stopped
from ._records import Fault
from ._steps import Steps, blocking, next_row, run
from .errors import PolepairError
from .quantity import Amount, PositionUnit, Quantity, Signal

if TYPE_CHECKING:
    from .events import Events, Happening, Subscription
    from .paths import Paths

__all__ = [
    "Armed",
    "Axis",
    "Group",
    "GroupMotion",
    "Link",
    "Motion",
    "Parameters",
    "RawParameters",
    "Watch",
]


class Axis(AxisSteps):
    """One motor.

    >>> import polepair
    >>> with polepair.connect("sim:tmcl?time=virtual") as link:
    ...     axis = link.axes[0]
    ...     with axis.armed():
    ...         axis.move(90, "deg").wait()
    ...     round(axis.read("position")["position"], 2)
    1.57
    """

    __slots__ = ()

    @property
    def params(self) -> Parameters:
        """Parameters by name: `axis.params["max current"] = 1.2`."""
        return Parameters(self)

    @property
    def paths(self) -> Paths:
        """Paths that the drive stores (SYNTRON TS): `axis.paths.run(1)`."""
        from .paths import Paths

        return Paths(self)

    enable = blocking(AxisSteps._enable)
    disable = blocking(AxisSteps._disable)
    stop = blocking(AxisSteps._stop)
    quick_stop = blocking(AxisSteps._quick_stop)
    clear = blocking(AxisSteps._clear)
    spin = blocking(AxisSteps._spin)
    torque = blocking(AxisSteps._press)
    home = blocking(AxisSteps._home)
    reached = blocking(AxisSteps._reached)
    read = blocking(AxisSteps._read)
    read_text = blocking(AxisSteps._read_text)
    read_bytes = blocking(AxisSteps._read_bytes)
    write_bytes = blocking(AxisSteps._write_bytes)
    capture = blocking(AxisSteps._capture)
    record_in_drive = blocking(AxisSteps._record_in_drive)
    couple = blocking(AxisSteps._couple)
    uncouple = blocking(AxisSteps._uncouple)
    state = blocking(AxisSteps._state)
    step = blocking(AxisSteps._step)

    def raw(self, said: str | bytes, *, id: int | None = None) -> int:
        """Sends a request as text of the protocol, such as `GAP 1`, and returns the value of the reply.

        Bytes are a complete frame to this axis, on CAN with its identifier. Errors: `Unsupported`
        E221 if it is not a request to this axis; nothing was sent.

        `axis.raw("GAP 1")`, `axis.raw(b"...", id=0x601)`
        """
        return self._native.raw(said, id)

    def events(self) -> Events:
        """Events of this axis and its link: `for event in axis.events()`."""
        from .events import Events

        return Events(self._native.events())

    def faults(self) -> list[Fault]:
        """Active faults and warnings, with cause and remedy."""
        return run(self._faults())

    def move(
        self,
        target: Amount,
        unit: PositionUnit | None = None,
        *,
        velocity: Amount | None = None,
        acceleration: Amount | None = None,
        deceleration: Amount | None = None,
    ) -> Motion:
        """rad (m) or with a unit: starts a move to a position. The axis must be armed.

        Returns as soon as the drive has acknowledged the start; `wait` on the result waits for the end.

        `axis.move(90, "deg", velocity="60 rpm").wait()`
        """
        run(self._set_out("move-to", target, unit, velocity, acceleration, deceleration))
        return Motion(self)

    def move_by(
        self,
        distance: Amount,
        unit: PositionUnit | None = None,
        *,
        velocity: Amount | None = None,
        acceleration: Amount | None = None,
        deceleration: Amount | None = None,
    ) -> Motion:
        """rad (m) or with a unit: starts a move by a distance from the actual position. Never sent twice.

        `axis.move_by(-5, "mm").wait()`
        """
        run(self._set_out("move-by", distance, unit, velocity, acceleration, deceleration))
        return Motion(self)

    def armed(self, watchdog: float | None = None) -> Armed:
        """Arms the axis during a `with` block, whose end stops and disables it.

        `watchdog`: seconds without a message after which the drive stops; `Unsupported` if it has no
        watchdog.

        `with axis.armed(watchdog=0.5): axis.spin(60, "rpm")`
        """
        return Armed(self, watchdog)

    def watch(
        self, *signals: Signal | str, period: float = 0.1, seconds: float | None = None
    ) -> Watch:
        """Reads signals periodically: seconds since the start, and values in SI.

        A server sends them by itself; `lost` of the result counts missing samples.

        `for time, values in axis.watch("velocity", period=0.05, seconds=2): print(time, values["velocity"])`
        """
        if self._native.is_remote:
            stream = self._native.watch(list(signals), period)
            return Watch(_told(stream, self.label, signals, seconds), stream)
        return Watch(self._polled(signals, period, seconds))

    def _polled(
        self, signals: tuple[str, ...], period: float, seconds: float | None
    ) -> Generator[Row, None, None]:
        began = self._native.now
        while True:
            now = self._native.now
            if seconds is not None and now - began >= seconds:
                return
            yield now - began, self.read(*signals)
            self._native.sleep(max(0.0, period - (self._native.now - now)))


Row: TypeAlias = tuple[float, dict[str, float]]
"""Time in seconds, and the value of each signal."""


class Watch(Iterator[Row]):
    """A subscription to signals: iterates over rows of time and values."""

    __slots__ = ("_rows", "_stream")

    def __init__(
        self, rows: Generator[Row, None, None], stream: native.SampleStream | None = None
    ) -> None:
        self._rows = rows
        self._stream = stream

    def __next__(self) -> Row:
        return next(self._rows)

    def __repr__(self) -> str:
        return f"<Watch: {self.lost} samples lost>"

    @property
    def lost(self) -> int:
        """Missing samples of the signal that lost most."""
        return 0 if self._stream is None else self._stream.lost

    def close(self) -> None:
        """Ends the subscription."""
        self._rows.close()
        self._stream = None


def _told(
    stream: native.SampleStream, label: str, signals: tuple[str, ...], seconds: float | None
) -> Generator[Row, None, None]:
    began: float | None = None
    since = time.monotonic()
    while True:
        left = None if seconds is None else max(0.0, since + seconds - time.monotonic())
        row = run(next_row(stream, label, left))
        if row is None:
            return
        began = row[0] if began is None else began
        if seconds is not None and row[0] - began >= seconds:
            return
        yield row[0] - began, dict(zip(signals, row[1], strict=True))


class Motion:
    """A move that is being executed."""

    __slots__ = ("_asked", "_axis")

    def __init__(self, axis: Axis) -> None:
        self._axis = axis
        self._asked: Asked = []

    def wait(self, timeout: float = TIMEOUT) -> None:
        """Waits until the axis has arrived. Errors: `PolepairError` E101 after the time limit."""
        run(self._axis._arrive(timeout, self._asked))

    def done(self) -> bool:
        """True if the axis has arrived."""
        return run(self._axis._done(self._asked))

    def cancel(self) -> None:
        """Stops the axis."""
        self._axis.stop()

    def __repr__(self) -> str:
        return f"<Motion of {self._axis.label}>"


class Group(GroupSteps[Axis]):
    """Axes of a link that move together.

    >>> import polepair
    >>> with polepair.connect("sim:cia402:1,2?time=virtual") as link:
    ...     with link.group(1, 2).armed() as both:
    ...         both.move({1: 1.0, 2: 0.5}).wait()
    ...         [round(axis.read("position")["position"], 2) for axis in both.axes]
    [1.0, 0.5]
    """

    __slots__ = ()

    stop = blocking(GroupSteps._stop)

    def move(
        self,
        targets: Targets,
        unit: PositionUnit | None = None,
        *,
        velocity: Amount | None = None,
        acceleration: Amount | None = None,
        sync: bool = True,
    ) -> GroupMotion:
        """rad (m) or with a unit: starts a move of each axis, by name or number, or in the group's order.

        With `sync` each drive is prepared, and one message on the bus starts all of them. Errors:
        `Unsupported` E218 for drives without this function; nothing was sent. Without `sync`, they are
        started one directly after the other.

        `group.move({1: "90 deg", 2: "45 deg"}).wait()`, `group.move([90, 45], "deg")`
        """
        moving = run(self._set_out("move-to", targets, unit, velocity, acceleration, sync))
        return GroupMotion(self, moving)

    def move_by(
        self,
        distances: Targets,
        unit: PositionUnit | None = None,
        *,
        velocity: Amount | None = None,
        acceleration: Amount | None = None,
        sync: bool = True,
    ) -> GroupMotion:
        """rad (m) or with a unit: starts moves by distances from the actual positions. Never sent twice.

        `group.move_by([10, -10], "deg").wait()`
        """
        moving = run(self._set_out("move-by", distances, unit, velocity, acceleration, sync))
        return GroupMotion(self, moving)

    def armed(self, watchdog: float | None = None) -> GroupArmed:
        """Arms the axes during a `with` block, whose end stops and disables all of them.

        `with link.group(1, 2).armed() as both: both.move([1.0, 0.5]).wait()`
        """
        return GroupArmed(self, watchdog)


class GroupMotion:
    """Moves of several axes that are being executed."""

    __slots__ = ("_group", "_moving")

    def __init__(self, group: Group, moving: list[Axis]) -> None:
        self._group = group
        self._moving = moving

    def wait(self, timeout: float = TIMEOUT) -> None:
        """Waits until all axes have arrived. Errors: `PolepairError` E101 after the time limit."""
        run(self._group._arrive(self._moving, timeout))

    def done(self) -> bool:
        """True if all axes have arrived."""
        return all(axis.reached(0.0) for axis in self._moving)

    def cancel(self) -> None:
        """Stops the group."""
        self._group.stop()

    def __repr__(self) -> str:
        return f"<Motion of {', '.join(axis.label for axis in self._moving)}>"


class GroupArmed:
    """Armed axes during a `with` block."""

    __slots__ = ("_before", "_group", "_watchdog")

    def __init__(self, group: Group, watchdog: float | None) -> None:
        self._group = group
        self._watchdog = watchdog
        self._before: list[Settings] = []

    def __repr__(self) -> str:
        return f"<Armed group of {', '.join(axis.label for axis in self._group.axes)}>"

    def __enter__(self) -> Group:
        self._before = run(self._group._arm(self._watchdog))
        return self._group

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        _released(self._group._release(self._before), error)


class Armed(ArmedOf[Axis]):
    """An armed axis during a `with` block."""

    __slots__ = ()

    def __enter__(self) -> Axis:
        self._before = run(self._axis._arm(self._watchdog))
        return self._axis

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        _released(self._axis._release(self._before), error)


def _released(steps: Steps[None], error: BaseException | None) -> None:
    """Stops and disables the axis, also after an exception."""
    try:
        run(steps)
    except PolepairError as failed:
        not_stopped(failed, error)


class Parameters(ParametersOf[Axis], MutableMapping[str, Quantity]):
    """Parameters of a drive by name, in their units."""

    __slots__ = ()

    @property
    def raw(self) -> RawParameters:
        """The same as raw numbers of the drive."""
        return RawParameters(self._axis)

    def __getitem__(self, name: str) -> Quantity:
        return run(self._axis._get(name))

    def __setitem__(self, name: str, amount: Amount) -> None:
        run(self._axis._set(name, amount))

    def keep(self, name: str, amount: Amount) -> None:
        """Writes a parameter, and stores it in permanent memory.

        `axis.params.keep("max current", "1.2 A")`
        """
        run(self._axis._set(name, amount, keep=True))

    def __delitem__(self, name: str) -> None:
        raise TypeError("a drive's parameters cannot be deleted")


class RawParameters(ParametersOf[Axis], Mapping[str, int]):
    """Parameters of a drive by name, as raw numbers."""

    __slots__ = ()

    def __getitem__(self, name: str) -> int:
        return self._axis._native.read_raw(name)

    def __setitem__(self, name: str, raw: int) -> None:
        self._axis._native.write_raw(name, raw)


class Link(LinkOf[Axis]):
    """An open link and its axes; a `with` block closes it."""

    __slots__ = ()

    def _axis(self, axis: native.Axis) -> Axis:
        return Axis(axis)

    def group(self, *which: int | str) -> Group:
        """A group of axes by number or name; without arguments, all axes.

        `link.group(1, 2)`, `link.group("left", "right")`
        """
        return Group(self._chosen(which))

    def events(self) -> Events:
        """Events of all wires and axes: `for event in link.events()`."""
        from .events import Events

        return self._heard(Events(self._open().events()))

    def on_event(self, function: Callable[[Happening], object]) -> Subscription:
        """Calls a function with each event, in its own thread, until `end` of the result, or until the
        link is closed. Exceptions of the function are reported, and the next event is still delivered.

        `link.on_event(print)`
        """
        return self._subscribed(function)

    def stop(self) -> None:
        """Stops all axes. All stops are sent before the first confirmation is awaited."""
        self._open().stop_all()

    def sleep(self, seconds: float) -> None:
        """Waits for seconds on the link's clock. In virtual time this returns at once.

        `link.sleep(0.5)`
        """
        self._open()
        self._axes[0]._native.sleep(seconds)

    def __enter__(self) -> Link:
        self._open()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
