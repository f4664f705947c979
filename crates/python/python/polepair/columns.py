"""Tables of a decoded capture, as they are and for Arrow, NumPy, pandas and Polars.

Columns and their types are those of `docs/reference/columns.md`. None of these libraries is needed
until it is asked for; any reader of Arrow's PyCapsule interface takes a `Table` as it is.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from . import _polepair as native

if TYPE_CHECKING:
    import numpy
    import pandas
    import polars
    import pyarrow

__all__ = ["TABLES", "Arrays", "Table", "Tables"]

TABLES = ("frames", "signals", "transactions", "events")
"""Names of the tables, in order."""

SHOWN = 10
"""Rows that a notebook shows of a table."""


def extra(module: str, install: str) -> Any:
    """An optional library, or an error with the command that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError as missing:
        raise ImportError(f"this needs {module}: pip install {install}") from missing


class Table:
    """A table of a decoded capture. Its memory is shared with its readers, never copied.

    `polars.DataFrame(table)`, `pyarrow.table(table)`, `duckdb.sql("select … from table")` and
    `pandas.DataFrame.from_arrow(table)` take it as it is.
    """

    __slots__ = ("_native",)

    def __init__(self, columns: native.Columns) -> None:
        self._native = columns

    @property
    def name(self) -> str:
        """frames, signals, transactions or events."""
        return self._native.name

    @property
    def columns(self) -> dict[str, str]:
        """Each column's name and its Arrow type."""
        return dict(self._native.fields())

    def __len__(self) -> int:
        return len(self._native)

    def __arrow_c_schema__(self) -> object:
        return self._native.__arrow_c_schema__()

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        return self._native.__arrow_c_stream__(requested_schema)

    def to_arrow(self) -> pyarrow.Table:
        """As pyarrow has it, without a copy; needs `polepair[arrow]`."""
        made: pyarrow.Table = extra("pyarrow", "polepair[arrow]").table(self)
        return made

    def to_numpy(self) -> Arrays:
        """The columns as arrays, each made at its first use; needs NumPy."""
        extra("numpy", "numpy")
        return Arrays(self._native)

    def to_polars(self) -> polars.DataFrame:
        """As Polars has it, without a copy; needs Polars."""
        made: polars.DataFrame = extra("polars", "polars").DataFrame(self)
        return made

    def to_pandas(self) -> pandas.DataFrame:
        """As pandas has it, words as categories; needs pandas, and not pyarrow."""
        pd = extra("pandas", "pandas")
        arrays = self.to_numpy()
        series = {name: arrays._series(name, pd) for name in self.columns}
        made: pandas.DataFrame = pd.DataFrame(series, copy=False)
        return made

    def __repr__(self) -> str:
        return f"<Table {self.name}: {len(self):,} rows, {len(self.columns)} columns>"

    def _repr_html_(self) -> str:
        from ._html import table

        names = list(self.columns)
        cells = [self._native.cells(name, SHOWN) for name in names]
        rows = list(zip(*cells, strict=True))
        return table(names, rows, f"{self.name}: {len(self):,} rows")

    def __reduce__(self) -> tuple[Any, ...]:
        raise TypeError("a table cannot be pickled: pass to_arrow() or to_pandas()")


class Tables(NamedTuple):
    """The four tables of a capture."""

    frames: Table
    signals: Table
    transactions: Table
    events: Table


class Arrays(Mapping[str, "numpy.ndarray[Any, Any]"]):
    """A table's columns as NumPy arrays.

    Numbers and times lie where they were decoded if the table is of one batch (half a MiB of the
    capture or 32,768 frames), else they are put together once, when first asked for. A column with rows that have no
    value is a masked array, times without a value are NaT. Words are object arrays of str; `codes`
    gives them as numbers. `data` is `uint8` of shape (rows, longest), filled up with zeros;
    `data_len` has their lengths.
    """

    __slots__ = ("_made", "_names", "_native")

    def __init__(self, columns: native.Columns) -> None:
        self._native = columns
        self._made: dict[str, numpy.ndarray[Any, Any]] = {}
        names = {}
        for name, kind in columns.fields():
            names[name] = kind
            if kind == "Binary":
                names[f"{name}_len"] = "Int32"
        self._names = names

    def __getitem__(self, name: str) -> numpy.ndarray[Any, Any]:
        if name not in self._made:
            self._made[name] = self._make(name, self._names[name])
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        return f"<{len(self)} arrays of {len(self._native):,} rows: {', '.join(self)}>"

    def codes(self, name: str) -> tuple[numpy.ndarray[Any, Any], list[str]]:
        """A column of words as numbers (int32; -1 for none) and the words that they number."""
        import numpy as np

        lent, valid, words = self._native.lend(name)
        if words is None:
            raise KeyError(f"`{name}` is no column of words")
        codes = np.asarray(lent)
        return (codes if valid is None else np.where(np.asarray(valid), codes, -1)), words

    def _make(self, name: str, kind: str) -> numpy.ndarray[Any, Any]:
        import numpy as np

        if kind.startswith("Dictionary"):
            codes, words = self.codes(name)
            worded: numpy.ndarray[Any, Any] = np.array([*words, None], dtype=object)[codes]
            return worded
        if kind == "Utf8":
            return np.array(self._native.texts(name), dtype=object)
        if kind == "Binary" or name not in dict(self._native.fields()):
            column = name.removesuffix("_len")
            filled, lengths = self._native.lend_bytes(column)
            self._made[f"{column}_len"] = np.asarray(lengths)
            self._made[column] = np.asarray(filled)
            return self._made[name]
        lent, valid, _ = self._native.lend(name)
        values = np.asarray(lent)
        if valid is None:
            return values
        there = np.asarray(valid)
        if kind.startswith("Timestamp"):
            return np.where(there, values, np.datetime64("NaT"))
        return np.ma.MaskedArray(values, mask=~there)

    def _series(self, name: str, pd: Any) -> Any:
        """A column as pandas has it."""
        kind = self._names[name]
        if kind.startswith("Dictionary"):
            codes, words = self.codes(name)
            return pd.Categorical.from_codes(codes, words)
        if kind == "Binary":
            return pd.Series(self._native.byte_strings(name), dtype=object)
        array: Any = self[name]
        if kind.startswith("Timestamp"):
            return pd.Series(array).dt.tz_localize("UTC")
        if hasattr(array, "mask"):
            return pd.arrays.IntegerArray(array.data.copy(), array.mask.copy())
        return array
