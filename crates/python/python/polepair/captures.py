"""Captures of buses: every frame explained, or all of them as columns."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from . import _polepair as native
from .columns import TABLES, Table, Tables

if TYPE_CHECKING:
    import pandas
    import polars
    import pyarrow

    from .columns import Arrays

__all__ = ["Capture", "decode"]


class Capture:
    """A capture of one or more buses.

    Iterated over, it gives its frames one after the other, in memory that stays bounded however long
    it is. `frames`, `signals`, `transactions` and `events` are the same as tables; each is decoded
    when it is first asked for, and `tables()` decodes all four in one pass.
    """

    __slots__ = ("_decoder", "_path", "_tables")

    def __init__(self, decoder: native.Decoder, path: str) -> None:
        self._decoder = decoder
        self._path = path
        self._tables: dict[str, Table] = {}

    @property
    def verdicts(self) -> list[str]:
        """Detected protocol of each link with its certainty, by the frames read so far.

        Empty if `protocols` was given.
        """
        return self._decoder.verdicts

    @property
    def damage(self) -> list[str]:
        """Unreadable places so far, over all iterators."""
        return self._decoder.damage

    def __iter__(self) -> Iterator[native.Event]:
        while events := self._decoder.read():
            yield from events

    @property
    def frames(self) -> Table:
        """A row for each frame, with its bytes."""
        return self.table("frames")

    @property
    def signals(self) -> Table:
        """A row for each value of a frame, in its unit."""
        return self.table("signals")

    @property
    def transactions(self) -> Table:
        """A row for each request and how it ended."""
        return self.table("transactions")

    @property
    def events(self) -> Table:
        """A row for each fault, change of state, and thing that a healthy bus does not do."""
        return self.table("events")

    def table(self, name: str) -> Table:
        """One table by name, decoded once. Errors: `Unsupported` E250 where there is none."""
        if name not in self._tables:
            self._tables[name] = Table(self._decoder.tables([name])[0])
        return self._tables[name]

    def tables(self) -> Tables:
        """All four, decoded in one pass: `frames, signals, transactions, events`."""
        missing = [name for name in TABLES if name not in self._tables]
        for decoded in self._decoder.tables(missing) if missing else []:
            self._tables[decoded.name] = Table(decoded)
        return Tables(*(self._tables[name] for name in TABLES))

    def to_arrow(self, table: str = "frames") -> pyarrow.Table:
        """A table as pyarrow has it, without a copy; needs `polepair[arrow]`."""
        return self.table(table).to_arrow()

    def to_numpy(self, table: str = "frames") -> Arrays:
        """A table's columns as NumPy arrays; needs NumPy."""
        return self.table(table).to_numpy()

    def to_pandas(self, table: str = "frames") -> pandas.DataFrame:
        """A table as a pandas data frame; needs pandas."""
        return self.table(table).to_pandas()

    def to_polars(self, table: str = "frames") -> polars.DataFrame:
        """A table as a Polars data frame, without a copy; needs Polars."""
        return self.table(table).to_polars()

    def __repr__(self) -> str:
        said = f": {'; '.join(self.verdicts)}" if self.verdicts else ""
        return f"<Capture {self._path}{said}>"

    def _repr_html_(self) -> str:
        from ._html import table

        counted = [(name, f"{len(self._tables[name]):,}") for name in TABLES if name in self._tables]
        told = [("capture", self._path), *(("link", verdict) for verdict in self.verdicts)]
        return table(["", ""], [*told, *counted])

    def __reduce__(self) -> tuple[Any, ...]:
        raise TypeError(
            "a capture cannot be pickled: pass its path and decode it there, or pass "
            "to_arrow() or to_pandas()"
        )


def decode(
    path: str | os.PathLike[str],
    *,
    protocols: str | None = None,
    profile: str | None = None,
    format: str | None = None,
) -> Capture:
    """Explains every frame of a capture file. `for event in decode("machine.log"): print(event.text)`

    `protocols` states the protocols as the command line's `--as` does: `canopen@2,thruster@11`. Without it
    they are detected in the file first. `profile` is the product whose names are used. Errors: `OSError`
    if the file cannot be read, `Unsupported` for unknown words.
    """
    return Capture(native.Decoder(path, protocols, profile, format), os.fspath(path))
