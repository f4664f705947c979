"""Methods of a group, shared by threads and event loops."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Generic, TypeVar

from . import _polepair as native
from ._axis import TIMEOUT, AxisSteps, Settings
from ._steps import Call, Steps, Urgent, Wait
from .errors import PolepairError
from .quantity import Amount, given

__all__ = ["GroupSteps", "Targets"]

Targets = Mapping[int | str, Amount] | Sequence[Amount]
"""A target for each axis: by name or number, or in the group's order."""

A = TypeVar("A", bound=AxisSteps)


class GroupSteps(Generic[A]):
    """Base of groups: the verbs of several axes as steps."""

    __slots__ = ("axes",)

    axes: tuple[A, ...]
    """The axes, in the given order."""

    def __init__(self, axes: Iterable[A]) -> None:
        self.axes = tuple(axes)
        if not self.axes:
            raise ValueError("a group needs an axis")

    def __repr__(self) -> str:
        return f"<Group of {', '.join(axis.label for axis in self.axes)}>"

    def _repr_html_(self) -> str:
        from ._html import table

        rows = [(axis.number, axis.name, axis.title) for axis in self.axes]
        return table(["axis", "name", "product"], rows)

    def _of(self, targets: Targets) -> list[tuple[A, Amount]]:
        if not isinstance(targets, Mapping):
            return list(zip(self.axes, targets, strict=True))
        found = []
        for which, target in targets.items():
            axes = [axis for axis in self.axes if which in (axis.number, axis.name)]
            if not axes:
                raise KeyError(f"{self} has no axis {which!r}")
            found.append((axes[0], target))
        return found

    def _set_out(
        self,
        verb: str,
        targets: Targets,
        unit: str | None,
        velocity: Amount | None,
        acceleration: Amount | None,
        sync: bool,
    ) -> Steps[list[A]]:
        speed, ramp = given(velocity), given(acceleration)
        moves = [(axis, given(target, unit)) for axis, target in self._of(targets)]
        if sync:
            rows = [(axis._native, verb, target, speed, ramp) for axis, target in moves]
            yield Call(native.begin_together, rows)
        else:
            begun = []
            for axis, target in moves:
                begun.append((yield Call(axis._native.start, verb, target, speed, ramp)))
            for request in begun:
                yield Wait(request)
        return [axis for axis, _ in moves]

    def _arrive(self, axes: Iterable[A], timeout: float = TIMEOUT) -> Steps[None]:
        for axis in axes:
            yield from axis._arrive(timeout)

    def _stop(self) -> Steps[None]:
        """Stops all axes. All stops are sent before the first confirmation is awaited."""
        yield from self._stop_each(self.axes, AxisSteps._begin)

    def _stop_each(
        self, axes: Iterable[A], begin: Callable[[AxisSteps, str], Steps[Any]]
    ) -> Steps[None]:
        """Stops all axes, even after an error. Raises the first error."""
        begun, failed = [], None
        for axis in axes:
            if "stop" in axis.verbs:
                try:
                    begun.append((yield from begin(axis, "stop")))
                except PolepairError as error:
                    failed = failed or error
        for request in begun:
            try:
                if request is not None:
                    yield Wait(request)
            except PolepairError as error:
                failed = failed or error
        if failed is not None:
            raise failed

    def _arm(self, watchdog: float | None) -> Steps[list[Settings]]:
        before: list[Settings] = []
        try:
            for axis in self.axes:
                before.append((yield from axis._arm(watchdog)))
        except BaseException:
            yield from self._release(before)
            raise
        return before

    def _release(self, before: Sequence[Settings]) -> Steps[None]:
        """Stops all axes at once, then disables and disarms each. Every step is tried, even after an
        error."""
        failed: BaseException | None = None
        # The others were not armed here, or are ours no more: that has stopped them.
        ours = self.axes[: len(before)]
        own = [axis._native for axis in ours if not axis._native.is_remote]
        try:
            if own:
                yield Urgent(native.stop_axes, own)
            else:
                yield from self._stop_each(ours, AxisSteps._begin_own)
        except PolepairError as error:
            failed = error
        for axis, watchdog in zip(self.axes, before, strict=False):
            try:
                yield from axis._release(watchdog, stop=not own)
            except PolepairError as error:
                failed = failed or error
        if failed is not None:
            raise failed
