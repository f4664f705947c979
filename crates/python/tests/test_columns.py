"""Captures as columns: lent to Arrow's readers, to NumPy and pandas."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import polepair
import pyarrow as pa
import pyarrow.compute as pc
import pytest

FRAMES = 70_000
"""More than one batch has."""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A CANopen node that tells its state and position, and is asked now and then."""
    lines = []
    for at in range(FRAMES):
        time = f"({1_700_000_000 + at // 1000}.{at % 1000 * 1000:06})"
        position = (at * 7 - 1000).to_bytes(4, "little", signed=True).hex().upper()
        kind = at % 5
        if kind == 3:
            lines.append(f"{time} can0 602#4064600000000000")
        elif kind == 4:
            lines.append(f"{time} can0 582#43646000{position}")
        else:
            lines.append(f"{time} can{kind % 2} 182#3712{position}")
    lines.append("(1700000100.000000) can0 082#1043010000000000")
    file = tmp_path_factory.mktemp("captures") / "drive.log"
    file.write_text("\n".join(lines) + "\n")
    return file


@pytest.fixture(scope="module")
def capture(log: Path) -> polepair.Capture:
    return polepair.decode(log, protocols="canopen", profile="cia402")


def test_tables_say_what_events_say(log: Path, capture: polepair.Capture) -> None:
    frames = capture.to_numpy()
    events = list(polepair.decode(log, protocols="canopen", profile="cia402"))
    assert len(capture.frames) == len(events) == FRAMES + 1
    assert frames["seq"].tolist() == [event.number for event in events]
    assert frames["t_ns"].tolist() == [event.time_ns for event in events]
    assert frames["can_id"].tolist() == [event.id for event in events]
    assert frames["bus"].tolist() == [event.link for event in events]
    data, lengths = frames["data"], frames["data_len"]
    assert data.shape == (FRAMES + 1, 8) and data.dtype == np.uint8
    assert [bytes(row[:length]) for row, length in zip(data, lengths, strict=True)] == [
        event.bytes for event in events
    ]
    told = [n for event in events for kind, n in event.notices if kind == "signal"]
    signals = capture.to_numpy("signals")
    assert signals["value"].tolist() == [facts["value"] for facts in told]
    assert signals["signal"].tolist() == [facts["name"] for facts in told]
    assert "Actual/Position" in set(signals["signal"])


def test_numpy_is_lent_and_not_copied(log: Path) -> None:
    small = log.with_name("small.log")
    small.write_text("\n".join(log.read_text().splitlines()[:100]) + "\n")
    frames = polepair.decode(small, protocols="canopen").frames
    arrow = frames.to_arrow().column("seq").chunk(0).buffers()[1].address
    arrays = frames.to_numpy()
    there = arrays["seq"]
    assert there.__array_interface__["data"][0] == arrow
    assert not there.flags.writeable and there.dtype == np.int64
    # A borrowed array outlives its lender.
    del frames, arrays
    assert there.tolist() == list(range(1, 101))


def test_missing_values_are_masked(capture: polepair.Capture) -> None:
    arrays = capture.to_numpy()
    assert isinstance(arrays["dir"], np.ma.MaskedArray) and bool(arrays["dir"].mask.all())
    assert not isinstance(arrays["can_id"], np.ma.MaskedArray)
    assert arrays["t"].dtype == np.dtype("datetime64[us]")
    assert arrays["t"][0] == np.datetime64("2023-11-14T22:13:20")
    codes, words = arrays.codes("bus")
    assert words == ["can0", "can1"] and codes.dtype == np.int32
    assert set(arrays) >= {"t", "t_ns", "bus", "data", "data_len", "seq"}
    with pytest.raises(KeyError):
        arrays["nonsense"]


def test_arrows_readers_take_a_table_as_it_is(capture: polepair.Capture) -> None:
    signals = capture.signals
    position = "signal = 'Actual/Position'"
    there = pa.table(signals)
    assert there.schema.field("t_ns").type == pa.int64()
    assert there.schema.metadata[b"polepair.table"] == b"signals"
    wanted = pc.sum(there["value_i"]).as_py()
    polars = pl.DataFrame(signals)
    assert polars["value_i"].sum() == wanted
    assert capture.to_polars("signals").equals(polars)
    found = duckdb.sql(f"select count(*), max(value_i) from there where {position}").fetchall()
    mine = polars.filter(pl.col("signal") == "Actual/Position")
    assert found == [(len(mine), mine["value_i"].max())]
    # A stream is made anew for each reader.
    assert pa.table(signals).equals(there)


def test_pandas_has_categories(capture: polepair.Capture) -> None:
    frames = capture.to_pandas()
    assert list(frames.columns) == list(capture.frames.columns)
    assert isinstance(frames["bus"].dtype, pd.CategoricalDtype)
    assert frames["data"][0] == bytes.fromhex("371218FCFFFF")
    assert frames["dir"].isna().all()
    assert str(frames["t"][0]) == "2023-11-14 22:13:20+00:00"
    by_node = frames.groupby("can_id").size()
    assert by_node.sum() == FRAMES + 1
    faults = capture.to_pandas("events").query("event == 'fault'")
    assert len(faults) == 1


@pytest.mark.parametrize(
    ("module", "make", "says"),
    [
        ("pyarrow", lambda c: c.to_arrow(), "polepair[arrow]"),
        ("numpy", lambda c: c.to_numpy(), "pip install numpy"),
        ("polars", lambda c: c.to_polars(), "pip install polars"),
        ("pandas", lambda c: c.to_pandas(), "pip install pandas"),
        ("matplotlib.pyplot", lambda c: polepair.Trace("a", [0.0], {}).plot(), "polepair[plot]"),
    ],
)
def test_a_missing_library_is_named(
    capture: polepair.Capture, monkeypatch: pytest.MonkeyPatch, module: str, make: Any, says: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError) as raised:
        make(capture)
    assert says in str(raised.value)


def test_all_tables_are_made_in_one_pass(log: Path) -> None:
    capture = polepair.decode(log, protocols="canopen")
    frames, signals, transactions, events = capture.tables()
    assert capture.frames is frames and capture.events is events
    assert len(transactions) == len(signals) == FRAMES // 5 and len(frames) == FRAMES + 1
    assert set(transactions.to_numpy()["outcome"]) == {"done"}
    with pytest.raises(polepair.Unsupported) as raised:
        capture.table("nonsense")
    assert raised.value.code == "E250"


def test_an_empty_capture_has_empty_columns(tmp_path: Path) -> None:
    file = tmp_path / "empty.log"
    file.write_text("")
    capture = polepair.decode(file, protocols="tmcl")
    assert len(capture.frames) == len(capture.to_numpy()["t_ns"]) == 0
    assert capture.to_arrow("events").num_rows == len(capture.to_pandas()) == 0
    assert capture.to_numpy()["bus"].tolist() == []


def test_rows_of_several_batches_are_shown(tmp_path: Path) -> None:
    """A fault at the head and others behind more frames than a batch has."""
    fault, quiet = "082#1043010000000000", "182#0102"
    frames = [fault, *[quiet] * 40_000, "082#0000000000000000", *[quiet] * 40_000, fault]
    file = tmp_path / "sparse.log"
    file.write_text("".join(f"({at}.000000) can0 {frame}\n" for at, frame in enumerate(frames)))
    events = polepair.decode(file, protocols="canopen").events
    assert len(events.to_arrow().column("t_ns").chunks) > 1
    assert 3 <= len(events) <= 10
    assert events._repr_html_().count("<tr>") == 1 + len(events)


def test_captures_show_themselves(capture: polepair.Capture) -> None:
    assert "drive.log" in repr(capture) and "drive.log" in capture._repr_html_()
    assert repr(capture.frames) == f"<Table frames: {FRAMES + 1:,} rows, 12 columns>"
    html = capture.frames._repr_html_()
    assert html.count("<tr>") == 11 and "37 12 18 FC FF FF" in html
    for what in (capture, capture.frames):
        with pytest.raises(TypeError, match="pickled"):
            pickle.dumps(what)
