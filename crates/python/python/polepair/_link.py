"""Common parts of links, axes and parameters for threads and event loops."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from os import PathLike
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from . import _polepair as native
from ._axis import ELSEWHERE, AxisSteps, Settings
from ._records import Losses
from .errors import PolepairError

if TYPE_CHECKING:
    from .events import AsyncEvents, Events, Happening, Subscription

    # A bound that is text is compiled, and the first text that is makes every class of `ast`.
    _E = TypeVar("_E", bound=Events | AsyncEvents)

SERVERS = ("http://", "https://", "ws://", "wss://")
"""Beginnings of a server's URL."""

A = TypeVar("A", bound=AxisSteps)


def opened(
    url: str,
    profile: str | PathLike[str] | None,
    trace: bool,
    token_file: str | PathLike[str] | None,
    certificate: str | PathLike[str] | None,
    client_cert: str | PathLike[str] | None,
    client_key: str | PathLike[str] | None,
) -> native.Link:
    """Opens a link, or connects to the server of a URL."""
    if url.startswith(SERVERS):
        if profile is not None or trace:
            raise TypeError("profile and trace are for who opens a link; a server has its own")
    elif any(one is not None for one in (token_file, certificate, client_cert, client_key)):
        raise TypeError(f"tokens and certificates are for a server's URL: {', '.join(SERVERS)}")
    pinned = None if certificate is None else str(certificate)
    return native.connect(url, profile, trace, token_file, pinned, client_cert, client_key)


class LinkOf(Generic[A]):
    """An open link and its axes."""

    __slots__ = ("_axes", "_listening", "_native", "_process")

    def __init__(self, link: native.Link) -> None:
        self._listening: list[Callable[[], Events | AsyncEvents | None]] = []
        self._process = os.getpid()
        self._native: native.Link | None = link
        self._axes = [self._axis(axis) for axis in link.axes()]

    def _axis(self, axis: native.Axis) -> A:
        raise NotImplementedError

    @property
    def axes(self) -> list[A]:
        """Every axis, in order."""
        self._open()
        return list(self._axes)

    @property
    def url(self) -> str:
        """The connection string."""
        return self._open().url

    @property
    def simulation(self) -> Simulation:
        """The simulation behind a `sim:` link."""
        simulation = self._open().simulation
        if simulation is None:
            raise ValueError(f"{self.url} is no simulation")
        return Simulation(simulation)

    def axis(self, which: int | str) -> A:
        """The axis with this number, or this name in the rack file. `LINK#NUMBER` if several links of a
        server have the number.

        `link.axis(1)`, `link.axis("left")`
        """
        link = self._open()
        return self._axis(link.axis(which) if isinstance(which, int) else link.named(which))

    __getitem__ = axis

    def losses(self) -> list[Losses]:
        """Losses and errors of each wire."""
        return [Losses(*row) for row in self._open().losses()]

    def trace(self) -> list[str]:
        """The last frames on its wires, as the lines of a capture that `decode` reads.

        Empty unless it was opened with `connect(url, trace=True)`.
        """
        return self._open().trace() or []

    def _chosen(self, which: tuple[int | str, ...]) -> list[A]:
        return [self.axis(one) for one in which] if which else self.axes

    def _heard(self, events: _E) -> _E:
        from weakref import ref

        self._listening = [one for one in self._listening if one() is not None]
        self._listening.append(ref(events))
        return events

    def _subscribed(self, function: Callable[[Happening], object]) -> Subscription:
        from .events import Events, Subscription

        return Subscription(self._heard(Events(self._open().events())), function)

    def close(self) -> None:
        """Closes the link, and ends its event streams. Its axes then raise `PolepairError` E322.

        Armed axes are stopped, switched off and disarmed first. If this fails, the link is still
        closed, and the error names the motors that may turn.
        """
        # A forked child must neither stop nor close what it inherited.
        link = self._native if self._process == os.getpid() else None
        try:
            if link is not None:
                link.stop_armed()
        finally:
            for one in self._listening:
                if (events := one()) is not None:
                    events.close()
            if link is not None:
                link.close()
            self._native = None
            self._axes = []

    def _open(self) -> native.Link:
        if self._native is None:
            raise ValueError("this link is closed")
        return self._native

    def _repr_html_(self) -> str:
        from ._html import table

        if self._native is None:
            return "<p>a closed link</p>"
        rows = [(axis.number, axis.name, axis.title, axis.protocol) for axis in self._axes]
        return table(["axis", "name", "product", "protocol"], rows, self._native.url)

    def __reduce__(self) -> tuple[Any, ...]:
        raise TypeError(f"a link cannot be pickled: {ELSEWHERE}")

    def __repr__(self) -> str:
        if self._native is None:
            return "<Link, closed>"
        return f"<Link {self.url}: {', '.join(axis.label for axis in self._axes)}>"


class ParametersOf(Generic[A]):
    """Descriptions of a drive's parameters, without requests to the drive."""

    __slots__ = ("_axis",)

    def __init__(self, axis: A) -> None:
        self._axis = axis

    def info(self, name: str) -> native.Parameter:
        """The description: unit, range, default, value names, manual section.

        `axis.params.info("max current").unit`
        """
        return self._axis._native.parameters()[self._axis._native.find(name)]

    def __iter__(self) -> Iterator[str]:
        return (parameter.name for parameter in self._axis._native.parameters())

    def __len__(self) -> int:
        return len(self._axis._native.parameters())

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self._axis._native.has(name)

    def _ipython_key_completions_(self) -> list[str]:
        """Names that IPython and notebooks complete: `axis.params["ma<Tab>`."""
        return list(self)

    def __repr__(self) -> str:
        return f"<{len(self)} parameters of {self._axis.label}>"


class ArmedOf(Generic[A]):
    """An armed axis during a block."""

    __slots__ = ("_axis", "_before", "_watchdog")

    def __init__(self, axis: A, watchdog: float | None) -> None:
        self._axis = axis
        self._watchdog = watchdog
        self._before: Settings = []

    def __repr__(self) -> str:
        return f"<Armed {self._axis.label}>"


def not_stopped(failed: PolepairError, error: BaseException | None) -> None:
    """Raises the first error."""
    if error is None:
        raise failed
    notes = getattr(error, "__notes__", [])
    error.__notes__ = [*notes, f"And an axis could not be stopped: {failed}"]


class Simulation:
    """Simulated drives from outside the wire: acts, and the real state.

    >>> import polepair
    >>> with polepair.connect("sim:tmcl?time=virtual") as link:
    ...     link.simulation.act("load", 0.05)
    ...     link.simulation.truth().enabled
    False
    """

    __slots__ = ("_native",)

    def __init__(self, simulation: native.Simulation) -> None:
        self._native = simulation

    def __repr__(self) -> str:
        return f"<Simulation at {self.now:.3f} s>"

    @property
    def now(self) -> float:
        """Seconds since it began."""
        return self._native.now

    def run(self, seconds: float) -> None:
        """Advances the time. In virtual time this returns at once."""
        self._native.run(seconds)

    def act(
        self, what: str, value: float = 1.0, *, link: int = 0, drive: int = 0, motor: int = 0
    ) -> None:
        """Runs an act on a drive, or on one of its motors: `load` (N·m), `jam`, `supply` (V), `temperature` (degC),
        `encoder`, `input-3`, `fault` (its code), `power-cycle`, `home` (rad) and others, which an
        error lists. With its unit it is one text: `"supply=30 V"`, as for `polepair act`.
        """
        if not self._native.act(link, drive, what, value, motor):
            raise ValueError(f"drive {drive} on link {link} has no {what}")

    def truth(self, *, link: int = 0, drive: int = 0, motor: int = 0) -> native.Truth:
        """The real state of a motor, independent of the drive's reports."""
        return self._native.truth(link, drive, motor)
