"""Stored paths of a drive, shared by threads and event loops."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, TypeAlias

from . import _polepair as native
from ._polepair import PathFinding, PathTable
from ._steps import Call, Steps, Wait, Whole, blocking
from .errors import PolepairError

if TYPE_CHECKING:
    from ._axis import AxisSteps
    from .trace import Trace

__all__ = ["PathFinding", "PathTable", "Paths", "preview"]

Change: TypeAlias = tuple[int | None, str, str, str]
"""A difference: number of the path (None for the mechanics), field, value before and after."""

RUN = 600.0
"""Default time limit of a run, in seconds."""


class PathSteps:
    """Base of `Paths` and `aio.Paths`: what an axis does with its paths, as steps."""

    __slots__ = ("_axis",)

    def __init__(self, axis: AxisSteps) -> None:
        self._axis = axis

    def __repr__(self) -> str:
        return f"<Paths of {self._axis.label}>"

    def _read(self, unit: str | None = None) -> Steps[PathTable]:
        """Reads all paths. `unit` is "deg" or "mm"; the drive does not store which.

        Without it, a travel of 360 in each turn of the motor is taken for degrees. Errors: `Unsupported` E218 for a
        drive without paths.

        `print(axis.paths.read())`
        """
        table: PathTable = yield Call(native.read_paths, self._axis._native, unit)
        return table

    def _write(
        self, table: PathTable | str | PathLike[str], *, store: bool = False
    ) -> Steps[list[Change]]:
        """Writes a table, or a file, reads it back, and returns what was changed.

        Paths that the table does not have stay in the drive. They are in RAM until the next power-on; `store` puts
        them into flash. Errors: E217 for a path that cannot run; nothing was written.

        `axis.paths.write("feeder-paths.toml")`
        """
        paths = table if isinstance(table, PathTable) else PathTable.load(table)
        changes: list[Change] = yield Whole(native.write_paths, self._axis._native, paths, store)
        return changes

    def _run(
        self, path: int, *, unit: str | None = None, timeout: float = RUN
    ) -> Steps[float]:
        """Runs a path and those that it leads to, waits for the end, and returns the measured position.

        The axis must be armed. The position is in the unit of the mechanics. Errors: `PolepairError` E106 if the
        axis is elsewhere than its paths end, E101 after the time limit, E245 for paths that never end: start those
        with `start`.

        `axis.paths.run(1)`
        """
        table = yield from self._read(unit)
        chain = table.chain(path)
        if chain.endswith(("again and again", "until it is stopped")):
            hint = "`axis.paths.start` starts them, and `axis.stop` stops them"
            raise PolepairError(f"path {chain}", "E245", False, hint)
        began: float = yield Call(native.path_position, self._axis._native, table)
        yield from self._start(path)
        yield from self._axis._arrive(timeout)
        ended: float = yield Call(native.path_arrival, self._axis._native, table, path, began)
        return ended

    def _start(self, path: int) -> Steps[None]:
        """Starts a path, and returns when the drive has acknowledged it. The axis must be armed.

        `axis.paths.start(1)`
        """
        started = yield Call(native.start_path, self._axis._native, path)
        yield Wait(started)


class Paths(PathSteps):
    """The paths that a drive stores: those of the SYNTRON TS.

    >>> import polepair
    >>> with polepair.connect("sim:syntron-ts?time=virtual") as link:
    ...     link.axes[0].paths.read()
    <PathTable: paths >
    """

    __slots__ = ()

    read = blocking(PathSteps._read)
    write = blocking(PathSteps._write)
    run = blocking(PathSteps._run)
    start = blocking(PathSteps._start)


def preview(table: PathTable, path: int, *, start: float = 0.0, seconds: float = 60.0) -> Trace:
    """Runs a path on the motor model, from `start` in the unit of the mechanics, for `seconds` at most.

    Nothing moves. The trace has `position` in the unit of the mechanics, and `speed` of the motor in rpm.

    `polepair.paths.preview(table, 1).plot()`
    """
    from .trace import Trace

    times, positions, speeds = table.preview(path, start, seconds)
    units = {"position": table.unit, "speed": "rpm"}
    return Trace("motor model", times, {"position": positions, "speed": speeds}, units)
