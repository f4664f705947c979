"""Columns of decoded captures, as other people's engines read them, against the decode to JSON lines."""

import json
import random
from collections import Counter

import datafusion
import duckdb
import polars
import pyarrow as pa
import pyarrow.dataset  # noqa: F401, reached as pa.dataset
import pyarrow.parquet as pq
import pytest

from conftest import polepair

NODES = range(1, 9)
DAY = 86_400


def line(time, frame, link="can0"):
    return f"({time:.6f}) {link} {frame}\n"


def capture(seed=1, count=4000, begin=1_700_000_000.0, link="can0"):
    """A bus whose mappings stand in the capture, and the sum of each node's positions."""
    chance, now = random.Random(seed), begin
    lines, sums = [], Counter()
    for node in NODES:
        for sub, raw in [(0, 0), (1, 0x60410010), (2, 0x60640020), (0, 2)]:
            size = "2F" if sub == 0 else "23"
            data = raw.to_bytes(4, "little").hex().upper()
            lines.append(line(now, f"{0x600 + node:03X}#{size}001A{sub:02X}{data}", link))
            lines.append(line(now + 0.001, f"{0x580 + node:03X}#60001A{sub:02X}00000000", link))
            now += 0.002
    for _ in range(count):
        now += chance.uniform(0.0001, 0.001)
        node = chance.choice(NODES)
        kind = chance.randrange(20)
        if kind == 0:
            lines.append(line(now, f"{0x600 + node:03X}#4064600000000000", link))
            lines.append(line(now + 0.0002, f"{0x580 + node:03X}#4364600001020304", link))
        elif kind == 1:
            lines.append(line(now, f"{0x700 + node:03X}#05", link))
        else:
            position = chance.randint(-(2**31), 2**31 - 1)
            data = b"\x37\x06" + position.to_bytes(4, "little", signed=True)
            lines.append(line(now, f"{0x180 + node:03X}#{data.hex().upper()}", link))
            sums[node] += position
    return "".join(lines), sums


@pytest.fixture(scope="module")
def decoded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("columns")
    text, sums = capture()
    log = folder / "bus.log"
    log.write_text(text)
    polepair("decode", str(log), "--as", "canopen", "--format", "jsonl", "-o", f"{folder}/frames.jsonl")
    frames = [json.loads(row) for row in (folder / "frames.jsonl").read_text().splitlines()]
    for kind in ["parquet", "arrow"]:
        polepair("decode", str(log), "--as", "canopen", "--format", kind, "-o", f"{folder}/{kind}")
    return folder, frames, sums


def by_id(frames):
    return dict(Counter(frame["id"] for frame in frames))


FRAMES = "select can_id, count(*) as n from {} group by can_id"
SIGNALS = (
    "select axis, sum(value_i) as total from {} "
    "where signal = 'Actual/Position' and quality = 0 and req_id is null group by axis"
)


def test_duckdb(decoded):
    folder, frames, sums = decoded
    table = lambda name: f"'{folder}/parquet/{name}.parquet'"
    assert dict(duckdb.sql(FRAMES.format(table("frames"))).fetchall()) == by_id(frames)
    assert dict(duckdb.sql(SIGNALS.format(table("signals"))).fetchall()) == dict(sums)
    pairs = f"{table('signals')} s join {table('frames')} f on s.frame_seq = f.seq"
    joined = duckdb.sql(f"select count(*) from {pairs}").fetchall()
    assert joined == duckdb.sql(f"select count(*) from {table('signals')}").fetchall()


def test_polars(decoded):
    folder, frames, sums = decoded
    table = polars.scan_parquet(f"{folder}/parquet/frames.parquet")
    counts = table.group_by("can_id").agg(n=polars.len()).collect()
    assert dict(counts.iter_rows()) == by_id(frames)
    column = polars.col
    wanted = (column("signal") == "Actual/Position") & column("req_id").is_null()
    table = polars.scan_parquet(f"{folder}/parquet/signals.parquet").filter(wanted)
    totals = table.group_by("axis").agg(column("value_i").sum()).collect()
    assert dict(totals.iter_rows()) == dict(sums)


def test_datafusion(decoded):
    folder, frames, sums = decoded
    engine = datafusion.SessionContext()
    for name in ["frames", "signals"]:
        engine.register_parquet(name, f"{folder}/parquet/{name}.parquet")
    rows = engine.sql(FRAMES.format("frames")).to_pydict()
    assert dict(zip(rows["can_id"], rows["n"])) == by_id(frames)
    rows = engine.sql(SIGNALS.format("signals")).to_pydict()
    assert dict(zip(rows["axis"], rows["total"])) == dict(sums)


def test_every_frame_as_the_json_lines_have_it(decoded):
    folder, frames, _ = decoded
    rows = pq.read_table(f"{folder}/parquet/frames.parquet").to_pylist()
    assert all(one["t_ns"] <= other["t_ns"] for one, other in zip(rows, rows[1:]))
    rows.sort(key=lambda row: row["seq"])
    log = (folder / "bus.log").read_bytes()
    assert len(rows) == len(frames)
    for row, frame in zip(rows, frames):
        assert (row["can_id"], row["data"].hex().upper()) == (frame["id"], frame["bytes"])
        assert (row["bus"], row["protocol"]) == (frame["link"], frame["protocol"])
        assert abs(row["t_ns"] / 1e9 - frame["time"]) < 1e-6 and row["t_ns"] % 1000 == 0
        assert row["t"].timestamp() == pytest.approx(frame["time"], abs=2e-6)
        assert log[row["file_pos"] :].startswith(b"(")
        assert bool(row["flags"] & 256) == (not frame["ok"])


def test_arrow_holds_the_same(decoded):
    folder, _, _ = decoded
    for name in ["frames", "signals", "transactions", "events"]:
        with pa.ipc.open_file(f"{folder}/arrow/{name}.arrow") as file:
            arrow = file.read_all()
        parquet = pq.read_table(f"{folder}/parquet/{name}.parquet")
        assert arrow.schema.names == parquet.schema.names
        assert arrow.to_pylist() == parquet.to_pylist()


def test_spark_can_read_the_types(decoded):
    """Spark knows no unsigned integers and no nanosecond stamps, and wants what else it knows."""
    folder, _, _ = decoded
    for name in ["frames", "signals", "transactions", "events"]:
        file = pq.ParquetFile(f"{folder}/parquet/{name}.parquet")
        for field in file.schema_arrow:
            kind = field.type
            if pa.types.is_dictionary(kind):
                assert kind.index_type == pa.int32() and kind.value_type == pa.string()
            assert not pa.types.is_unsigned_integer(kind), field
            if pa.types.is_timestamp(kind):
                assert (kind.unit, kind.tz) == ("us", "UTC")
        said = file.metadata.metadata
        assert said[b"polepair.rules"] == b"canopen"
        assert len(said[b"polepair.source.blake3"]) == 64 and said[b"polepair.decoder"]
        assert file.schema_arrow.metadata[b"polepair.schema"] == b"polepair-columns/1"
        for group in range(file.metadata.num_row_groups):
            column = file.metadata.row_group(group).column(0)
            assert column.compression == "ZSTD"


def test_a_folder_becomes_a_data_set(tmp_path):
    captures, out = tmp_path / "captures", tmp_path / "set"
    (captures / "deeper").mkdir(parents=True)
    first, sums = capture(2, 500)
    second, others = capture(3, 500, 1_700_000_000.0 + DAY, "can1")
    (captures / "a.log").write_text(first)
    (captures / "deeper" / "b.log").write_text(second)
    (captures / "broken.pcap").write_bytes(bytes(range(256)))

    def decode(check):
        words = ["decode", str(captures), "--as", "canopen", "--site", "plant 2", "-o", str(out)]
        polepair(*words, check=check)
        return {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")}

    made = decode(check=False)
    assert made and not list(out.rglob(".*"))
    # Captures that are already decoded are left as they are; the broken one is tried again.
    assert decode(check=False) == made
    (captures / "broken.pcap").unlink()
    assert decode(check=True) == made

    signals = f"read_parquet('{out}/signals/**/*.parquet', hive_partitioning = true)"
    both = {node: sums[node] + others[node] for node in NODES}
    assert dict(duckdb.sql(SIGNALS.format(signals)).fetchall()) == both
    days = duckdb.sql(f"select distinct date::varchar, bus from {signals} order by 1").fetchall()
    assert days == [("2023-11-14", "can0"), ("2023-11-15", "can1")]
    frames = polars.scan_parquet(f"{out}/frames", hive_partitioning=True)
    total = len(first.splitlines()) + len(second.splitlines())
    assert frames.select(polars.len()).collect().item() == total
    types = pa.schema([("site", pa.string()), ("date", pa.string())])
    parts = pa.dataset.partitioning(types, flavor="hive")
    assert pa.dataset.dataset(f"{out}/frames", partitioning=parts).count_rows() == total
