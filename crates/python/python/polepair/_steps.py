"""One implementation for threads and for event loops.

A method that takes time is written once, as a generator that yields each wait: a `Call` that may
block for a moment, or a `Wait` for a request that is under way. `blocking` makes a method of it that
carries it out in the caller's thread; `aio.awaitable` one for the caller's event loop (PY-1).
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Generator
from typing import Any, Concatenate, ParamSpec, TypeVar

from ._polepair import Events, Request, SampleStream
from .errors import NoReply

P = ParamSpec("P")
R = TypeVar("R")
S = TypeVar("S")

Steps = Generator["Call | Wait", Any, R]


class Call:
    """A function that may block while a drive answers a question or two."""

    __slots__ = ("arguments", "function")

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self.function = function
        self.arguments = arguments


class Whole(Call):
    """A call that runs to its end even if its caller is cancelled: only then it can be undone."""

    __slots__ = ()


class Urgent(Whole):
    """A stop: it waits behind no other call."""

    __slots__ = ()


class Wait:
    """The end of a request, or the next event or row; None when it did not come within `timeout`
    seconds."""

    __slots__ = ("request", "timeout")

    def __init__(
        self,
        request: Request | Events | SampleStream,
        timeout: float | None = None,
    ) -> None:
        self.request = request
        self.timeout = timeout


def next_row(
    stream: SampleStream, label: str, within: float | None = None
) -> Steps[tuple[float, list[float]] | None]:
    """The next row of samples of a server; None if there was none `within` seconds.

    `NoReply` when the drive should have answered several times.
    """
    began, patience = time.monotonic(), stream.patience
    bounds = [bound for bound in (within, patience) if bound is not None]
    left = min(bounds, default=None)
    # Others' samples may have to come first.
    while (row := (yield Wait(stream, left))) is None:
        spent = time.monotonic() - began
        if within is not None and spent >= within:
            return None
        if patience is not None and spent >= patience:
            what = f"{label}: nothing came for {patience:g} s: the drive does not answer its server"
            raise NoReply(what, "E401", False, "look at its power and its cable")
        left = max(0.0, min(bounds) - spent) if bounds else None
    return row  # type: ignore[no-any-return]


def run(steps: Steps[R]) -> R:
    """Carries steps out in this thread. Other threads go on meanwhile, and Ctrl-C works."""
    try:
        step = next(steps)
        while True:
            try:
                if isinstance(step, Wait):
                    answer = step.request.result(step.timeout)
                else:
                    answer = step.function(*step.arguments)
            except BaseException as error:
                step = steps.throw(error)
            else:
                step = steps.send(answer)
    except StopIteration as end:
        return end.value  # type: ignore[no-any-return]


def blocking(
    steps: Callable[Concatenate[S, P], Steps[R]],
) -> Callable[Concatenate[S, P], R]:
    """The method that carries the steps out in the caller's thread."""

    @functools.wraps(steps)
    def method(self: S, /, *args: P.args, **kwargs: P.kwargs) -> R:
        return run(steps(self, *args, **kwargs))

    return method
