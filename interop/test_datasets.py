"""Data sets of captures that grow, of many programs at once and of killed ones, as DuckDB reads them: each row once."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

import duckdb
import pytest
from conftest import POLEPAIR
from polepair import fleet

DAY = 86_400
BEGIN = 1_700_006_400


def capture(first: int, count: int, step: float = 1.0, link: str = "can0") -> str:
    return "".join(f"({BEGIN + n * step:.6f}) {link} 181#{n % 256:02X}\n" for n in range(first, first + count))


def decode_words(captures: Path, dataset: Path) -> list[str]:
    return [str(POLEPAIR), "decode", str(captures), "--as", "canopen", "--tables", "frames", "-o", str(dataset)]


def decode_by_command(captures: Path, dataset: Path) -> int:
    ran = subprocess.run(decode_words(captures, dataset), capture_output=True, text=True, check=False, timeout=300)
    return ran.returncode


def decode_by_fleet(captures: Path, dataset: Path) -> int:
    report = fleet.decode(captures, dataset, protocols="canopen", tables=["frames"], retries=0, workers=2)
    return 1 if report.failed else 0


def rows(dataset: Path) -> tuple[int, int]:
    """All rows, and the different ones."""
    parts = f"{dataset}/frames/**/*.parquet"
    question = f"SELECT count(*), count(DISTINCT (t, bus, data)) FROM read_parquet('{parts}')"
    [(count, different)] = duckdb.sql(question).fetchall()
    return int(count), int(different)


DECODERS = pytest.mark.parametrize("decode", [decode_by_command, decode_by_fleet])
Decoder = Callable[[Path, Path], int]


@pytest.fixture
def captures(tmp_path: Path) -> Path:
    folder = tmp_path / "captures"
    folder.mkdir()
    return folder


@DECODERS
@pytest.mark.parametrize("pack", [lambda text: text.encode(), "gzip"], ids=["plain", "gzip"])
def test_a_capture_that_grows_has_each_row_once(
    captures: Path, tmp_path: Path, decode: Decoder, pack: Callable[[str], bytes] | str
) -> None:
    import gzip

    packed = (lambda text: gzip.compress(text.encode())) if isinstance(pack, str) else pack
    file = captures / ("bus.log.gz" if isinstance(pack, str) else "bus.log")
    (captures / "other.log").write_text(capture(0, 100, link="can7"))
    dataset = tmp_path / "dataset"
    for n in range(4):
        with file.open("ab") as out:
            out.write(packed(capture(1_000 * n, 1_000)))
        assert decode(captures, dataset) == 0
        assert rows(dataset) == (1_000 * (n + 1) + 100,) * 2
        assert decode(captures, dataset) == 0, "again, with nothing new"
    assert rows(dataset) == (4_100, 4_100)


def test_both_ways_go_on_with_each_others_data_set(captures: Path, tmp_path: Path) -> None:
    file, dataset = captures / "bus.log", tmp_path / "dataset"
    decoders = [decode_by_command, decode_by_fleet]
    for n in range(6):
        with file.open("a") as out:
            out.write(capture(500 * n, 500))
        assert decoders[n % 2](captures, dataset) == 0
        assert rows(dataset) == (500 * (n + 1),) * 2


@DECODERS
def test_a_new_capture_with_an_old_name_replaces_nothing(captures: Path, tmp_path: Path, decode: Decoder) -> None:
    file, dataset = captures / "bus.log", tmp_path / "dataset"
    file.write_text(capture(0, 1_000))
    assert decode(captures, dataset) == 0
    file.rename(captures / "bus-1.log")
    file.write_text(capture(1_000, 500))
    assert decode(captures, dataset) == 0
    assert rows(dataset) == (1_500, 1_500)
    # The archive goes elsewhere; its rows stay.
    (captures / "bus-1.log").unlink()
    file.write_text(capture(5_000, 300))
    assert decode(captures, dataset) == 0
    assert rows(dataset) == (1_800, 1_800)


@DECODERS
def test_a_capture_that_is_written_to_meanwhile_is_whole_later(
    captures: Path, tmp_path: Path, decode: Decoder
) -> None:
    file, dataset = captures / "live.log", tmp_path / "dataset"
    file.write_text(capture(0, 20_000))
    ended = threading.Event()
    written = 20_000

    def write() -> None:
        nonlocal written
        with file.open("a", buffering=1) as out:
            while not ended.is_set():
                out.write(capture(written, 10))
                out.flush()
                written += 10
                time.sleep(0.001)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        codes = {decode(captures, dataset) for _ in range(3)}
    finally:
        ended.set()
        writer.join()
    assert codes & {1, 7}, "it said that the capture changes"
    assert decode(captures, dataset) == 0
    assert rows(dataset) == (written, written)


def test_three_programs_decode_into_one_new_data_set(captures: Path, tmp_path: Path) -> None:
    for n in range(12):
        (captures / f"bus-{n}.log").write_text(capture(10_000 * n, 2_000))
    dataset = tmp_path / "dataset"
    programs = [
        subprocess.Popen(decode_words(captures, dataset), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    for program in programs:
        _, said = program.communicate(timeout=300)
        assert program.returncode == 0, said
    assert rows(dataset) == (24_000, 24_000)
    assert not [part for part in dataset.rglob(".*.part")]


def test_the_work_of_a_killed_program_is_resumed_though_the_capture_has_grown(captures: Path, tmp_path: Path) -> None:
    file, dataset = captures / "bus.log", tmp_path / "dataset"
    count = 0
    for n in range(12):
        # Many days, so that the parts take a while to get their names.
        with file.open("a") as out:
            out.write(capture(count, 40, step=DAY))
        count += 40
        program = subprocess.Popen(decode_words(captures, dataset), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(0.01 * n)
        program.send_signal(signal.SIGKILL)
        program.wait(timeout=60)
    assert decode_by_command(captures, dataset) == 0
    assert rows(dataset) == (count, count)


def test_a_program_that_is_killed_while_parts_get_their_names(captures: Path, tmp_path: Path) -> None:
    file, dataset = captures / "bus.log", tmp_path / "dataset"
    file.write_text(capture(0, 400, step=DAY))
    program = subprocess.Popen(decode_words(captures, dataset), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    frames = dataset / "frames"
    while program.poll() is None and not any(frames.rglob("part-*.parquet")):
        time.sleep(0.001)
    program.send_signal(signal.SIGKILL)
    program.wait(timeout=60)
    with file.open("a") as out:
        out.write(capture(400, 1, step=DAY))
    assert decode_by_command(captures, dataset) == 0
    assert rows(dataset) == (401, 401)


def test_three_thousand_days_need_few_descriptors(captures: Path, tmp_path: Path) -> None:
    (captures / "years.log").write_text(capture(0, 3_000, step=DAY))
    dataset = tmp_path / "dataset"
    ran = subprocess.run(
        decode_words(captures, dataset), capture_output=True, text=True, check=False, timeout=300,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64)),
    )
    assert ran.returncode == 0, ran.stderr
    assert rows(dataset) == (3_000, 3_000)


def test_many_links_with_long_names(captures: Path, tmp_path: Path) -> None:
    text = "".join(capture(n, 1, link=f"{n:03}-{'x' * 300}") for n in range(200))
    (captures / "links.log").write_text(text)
    dataset = tmp_path / "dataset"
    code = decode_by_command(captures, dataset)
    assert code == 0
    assert rows(dataset) == (200, 200)


def test_the_parts_are_readable_as_the_umask_says(captures: Path, tmp_path: Path) -> None:
    (captures / "bus.log").write_text(capture(0, 10))
    for decode in (decode_by_command, decode_by_fleet):
        dataset = tmp_path / decode.__name__
        before = os.umask(0o022)
        try:
            assert decode(captures, dataset) == 0
        finally:
            os.umask(before)
        modes = {part.stat().st_mode & 0o777 for part in dataset.rglob("*.parquet")}
        assert modes == {0o644}
