"""Questions to a data set of captures, by DuckDB and by the command line of `polepair.fleet`."""

from __future__ import annotations

import csv
import io
import shutil
import subprocess
import sys
from pathlib import Path

import polepair
import pyarrow
import pytest
from polepair import fleet
from pyarrow import parquet

BEGIN = 1_700_000_000
"""2023-11-14 22:13:20 UTC, a Tuesday: the week began on Monday the 13th."""
WEEK = 7 * 86_400


def line(seconds: float, frame: str) -> str:
    return f"({BEGIN + seconds:.6f}) can0 {frame}"


def write_capture(path: Path, begin: float, slowest: float) -> None:
    """A node that starts, answers eleven reads, one of them slowly, and has a fault."""
    lines = [line(begin, "702#00")]
    for n in range(11):
        delay = slowest if n == 5 else 0.0005
        lines.append(line(begin + 1 + n / 100, "602#4064600000000000"))
        lines.append(line(begin + 1 + n / 100 + delay, "582#4364600010000000"))
    lines.append(line(begin + 2, "082#1043010000000000"))
    path.write_text("\n".join(lines) + "\n")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fleet")
    captures = folder / "captures" / "cell"
    captures.mkdir(parents=True)
    write_capture(captures / "first.log", 0, 0.002)
    write_capture(captures / "later.log", WEEK, 0.003)
    root = folder / "plant's data"  # with a sign that SQL quotes
    done = subprocess.run(
        [sys.executable, "-m", "polepair", "decode", str(folder / "captures"), "--as", "canopen", "--site", "hall 2",
         "-o", str(root)],
        capture_output=True, text=True, check=False, timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return root


def rows(data: fleet.Dataset, question: str) -> list[dict[str, object]]:
    answer = data.ask(question)
    return [dict(zip(answer.columns, row, strict=True)) for row in answer.fetchall()]


def test_questions_have_the_answers_that_were_recorded(dataset: Path) -> None:
    with fleet.open(dataset) as data:
        assert [row["file"] for row in rows(data, "captures")] == ["cell/first.log", "cell/later.log"]
        assert {row["frames"] for row in rows(data, "captures")} == {24}

        faults = rows(data, "faults-by-week")
        assert [(row["axis"], row["code"], row["times"]) for row in faults] == [(2, 0x4310, 1), (2, 0x4310, 1)]
        assert [str(row["week"])[:10] for row in faults] == ["2023-11-13", "2023-11-20"]

        (restarts,) = rows(data, "restarts")
        assert (restarts["site"], restarts["bus"], restarts["axis"], restarts["restarts"]) == ("hall 2", "can0", 2, 2)

        slowest = rows(data, "slowest-answers")
        assert len(slowest) == 20
        assert [row["rtt_us"] for row in slowest[:3]] == [3000, 2000, 500]
        (times,) = rows(data, "answer-times")
        assert (times["answers"], times["median_us"], times["longest_us"]) == (22, 500, 3000)
        assert rows(data, "unanswered") == [] and rows(data, "retries") == []

        # The second of the reads: 22 frames of 8 bytes, 47 bits beside the data each.
        (load,) = rows(data, "bus-load")
        assert (load["frames_a_second"], load["bits_a_second"]) == (22, 22 * (47 + 64))
        assert load["percent_of_500k"] == 0.5
        assert [row["frames"] for row in rows(data, "coverage")] == [24, 24]


def test_every_question_can_be_asked_of_a_data_set_without_some_tables(dataset: Path, tmp_path: Path) -> None:
    shutil.copytree(dataset / "frames", tmp_path / "frames")
    with fleet.open(tmp_path) as data:
        for question in fleet.QUESTIONS:
            whole = data.ask(question).columns
            assert whole, question
        with fleet.open(dataset) as full:
            for table in polepair.columns.TABLES:
                named = full.sql(f"select * from {table} limit 0")
                empty = data.sql(f"select * from {table} limit 0")
                assert sorted(zip(named.columns, map(str, named.types), strict=True)) == sorted(
                    zip(empty.columns, map(str, empty.types), strict=True)
                ), table


def test_queries_of_ones_own(dataset: Path) -> None:
    with fleet.open(dataset) as data:
        counted = data.sql("select count(*) from transactions where op = ?", ["SDO read"])
        assert counted.fetchall() == [(22,)]
        assert len(data.to_pandas("slowest-answers")) == 20


def test_errors_tell_what_to_do(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="polepair decode CAPTURES -o"):
        fleet.open(tmp_path)
    with fleet.open(dataset) as data, pytest.raises(polepair.Unsupported, match="slowest-answers"):
        data.ask("slowest")


@pytest.mark.parametrize(
    ("metadata", "told"), [({"polepair.schema": "polepair-columns/2"}, "polepair-columns/2"), ({}, "no table")]
)
def test_tables_of_another_version_are_refused(metadata: dict[str, str], told: str, tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    table = pyarrow.table({"t_ns": [1]}).replace_schema_metadata(metadata)
    parquet.write_table(table, tmp_path / "frames" / "a.parquet")
    with pytest.raises(polepair.Unsupported, match=told):
        fleet.open(tmp_path)


def command(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "polepair.fleet", *words], capture_output=True, text=True, check=False, timeout=120
    )


def test_the_command_line_prints_tables_and_csv(dataset: Path) -> None:
    assert "slowest-answers" in command("questions").stdout
    table = command("ask", str(dataset), "restarts")
    assert table.returncode == 0 and "hall 2" in table.stdout
    done = command("sql", str(dataset), "select axis, count(*) as frames from signals group by axis", "--csv")
    assert list(csv.reader(io.StringIO(done.stdout))) == [["axis", "frames"], ["2", "22"]]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("ask", "nowhere", "odd"), "there is no data set in nowhere"),
        (("sql", "DATASET", "selec 1"), "the query"),
        (("sql", "DATASET", "select * from nothing", "--csv"), "nothing"),
    ],
)
def test_the_command_line_says_what_is_wrong(dataset: Path, words: tuple[str, ...], told: str) -> None:
    done = command(*(str(dataset) if word == "DATASET" else word for word in words))
    assert done.returncode == 2 and told in done.stderr and "Traceback" not in done.stderr
