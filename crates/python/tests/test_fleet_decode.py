"""Captures of a folder or bucket become one data set, whoever decodes them and whatever fails meanwhile."""

from __future__ import annotations

import hashlib
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from polepair import errors, fleet

CAPTURES = 24


def write_captures(folder: Path, count: int = CAPTURES) -> None:
    """Captures of some machines, each of its own length and day."""
    for n in range(count):
        begin = 1_700_000_000 + 86_400 * (n % 5)
        lines = []
        for at in range(40 + n):
            time, node = begin + n + at / 100, 1 + n % 7
            lines.append(f"({time:.6f}) can{n % 2} {0x600 + node:03X}#4064600000000000")
            lines.append(f"({time + 0.0004:.6f}) can{n % 2} {0x580 + node:03X}#43646000{n:02X}{at:02X}0000")
        path = folder / f"machine-{n % 3}" / f"{n:03}.log"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n")


def content(root: Path) -> dict[str, str]:
    """Every file of a data set, and what is in it."""
    files = sorted(path for path in root.rglob("*") if path.is_file())
    return {str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures")
    write_captures(folder)
    return folder


@pytest.fixture(scope="module")
def dataset(captures: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set that one thread makes."""
    root = tmp_path_factory.mktemp("sequential") / "dataset"
    report = fleet.decode(captures, root, workers=1, protocols="canopen", site="hall-2")
    assert (report.decoded, report.present, report.failed) == (CAPTURES, 0, ())
    return root


def test_the_data_set_is_the_one_that_the_command_makes(captures: Path, dataset: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "polepair", "decode", str(captures), "--as", "canopen", "--site", "hall-2",
         "-o", str(tmp_path / "dataset")],
        capture_output=True, text=True, check=False, timeout=120,
    )
    assert done.returncode == 0, done.stderr
    ours = {name: digest for name, digest in content(dataset).items() if not name.startswith("_captures")}
    assert content(tmp_path / "dataset") == ours


def test_threads_make_the_same_data_set(captures: Path, dataset: Path, tmp_path: Path) -> None:
    seen: list[fleet.Progress] = []
    root = tmp_path / "dataset"
    report = fleet.decode(captures, root, workers=4, protocols="canopen", site="hall-2", progress=seen.append)
    assert str(report) == f"{CAPTURES} decoded, 0 were decoded earlier, 0 failed"
    assert content(root) == content(dataset)
    assert (seen[0].captures, seen[-1].captures, seen[-1].of_captures) == (0, CAPTURES, CAPTURES)
    assert seen[-1].size == seen[-1].of_size == sum(path.stat().st_size for path in captures.rglob("*.log"))
    with fleet.open(root) as data:
        assert data.sql("select count(*) from signals").fetchall() == [(sum(40 + n for n in range(CAPTURES)),)]


def test_a_run_that_was_interrupted_goes_on(captures: Path, dataset: Path, tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    job = fleet.Job(str(captures), str(root), ("--as", "canopen", "--site", "hall-2"))
    listed = job.captures()
    assert {outcome.state for outcome in pickle.loads(pickle.dumps(job)).decode(listed[:9])} == {"decoded"}
    # One ended after its parts and before its note: they are written again.
    (note,) = [path for path in (root / "_done").iterdir() if "machine-0/000" in seen_name(root, path.name)]
    note.unlink()
    for path in (root / "_captures").iterdir():
        if note.name in path.read_text():
            path.unlink()
    report = fleet.decode(captures, root, protocols="canopen", site="hall-2")
    assert (report.decoded, report.present, report.failed) == (CAPTURES - 8, 8, ())
    assert content(root) == content(dataset)
    again = fleet.decode(captures, root, protocols="canopen", site="hall-2")
    assert (again.decoded, again.present) == (0, CAPTURES)


def seen_name(root: Path, blake3: str) -> str:
    return next(text for path in (root / "_captures").iterdir() if blake3 in (text := path.read_text()))


def test_other_options_replace_what_earlier_ones_gave(captures: Path, tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    fleet.decode(captures, root, protocols="canopen", tables=["frames", "signals"])
    report = fleet.decode(captures, root, protocols="canopen", tables=["frames"])
    assert (report.decoded, report.present) == (CAPTURES, 0)
    assert not list(root.glob("signals/**/*.parquet"))
    fresh = tmp_path / "fresh"
    fleet.decode(captures, fresh, protocols="canopen", tables=["frames"])
    parts = {name: digest for name, digest in content(root).items() if name.startswith("frames")}
    assert parts == {name: digest for name, digest in content(fresh).items() if name.startswith("frames")}


def test_folders_name_site_and_gateway(captures: Path, tmp_path: Path) -> None:
    folder, root = tmp_path / "captures", tmp_path / "dataset"
    for plant in ("north", "south"):
        shutil.copytree(captures, folder / plant)
        for path in (folder / plant).rglob("*.log"):
            path.write_text(path.read_text() + f"(1700000000.0) can0 703#0{len(plant)}\n# {plant}\n")
    fleet.decode(folder, root, protocols="canopen", site="{0}", gateway="{1} of {0}")
    with fleet.open(root) as data:
        sources = data.sql("select distinct site, source from signals order by all").fetchall()
        restarts = data.ask("captures")
        assert {"site", "source"} <= set(restarts.columns)
    expected = [(plant, f"machine-{n} of {plant}") for plant in ("north", "south") for n in range(3)]
    assert sources == expected
    with pytest.raises(errors.Unsupported, match=r"machine-0/000\.log does not have"):
        fleet.decode(captures, root, gateway="{1}")


def test_copies_of_a_capture_count_once(captures: Path, tmp_path: Path) -> None:
    folder = tmp_path / "captures"
    shutil.copytree(captures / "machine-1", folder / "a")
    shutil.copytree(captures / "machine-1", folder / "b")
    report = fleet.decode(folder, tmp_path / "dataset", workers=8, protocols="canopen")
    assert (report.decoded, report.present) == (CAPTURES // 3, CAPTURES // 3)
    with fleet.open(tmp_path / "dataset") as data:
        files = data.sql("select distinct file from frames").fetchall()
    assert len(files) == CAPTURES // 3 and all(name.startswith("a/") for (name,) in files)


def test_failures_are_named_and_tried_again(captures: Path, tmp_path: Path) -> None:
    folder, root = tmp_path / "captures", tmp_path / "dataset"
    shutil.copytree(captures / "machine-1", folder)
    (folder / "broken.log").write_bytes(bytes(range(256)) * 40)
    (folder / "doubtful.log").write_text("(1.000000) can0 141#A200000010270000\n")
    (folder / "gone.log").symlink_to(tmp_path / "nowhere")
    report = fleet.decode(folder, root)
    assert [each.capture.name for each in report.failed] == ["broken.log", "gone.log"]
    broken, gone = report.failed
    assert "E510" in broken.reason and not broken.retry
    assert "nowhere" in gone.reason or "gone.log" in gone.reason
    assert gone.retry
    assert any(name == "doubtful.log" and "none of the protocols" in note for name, note in report.notes)
    shutil.copy(captures / "machine-0" / "000.log", tmp_path / "nowhere")
    again = fleet.decode(folder, root)
    assert (again.decoded, [each.capture.name for each in again.failed]) == (1, ["broken.log"])


def test_wrong_calls_say_what_to_do(captures: Path, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="there is no capture in"):
        fleet.decode(tmp_path, tmp_path / "dataset")
    with pytest.raises(errors.Unsupported, match="canopne"):
        fleet.decode(captures, tmp_path / "dataset", protocols="canopne")
    with pytest.raises(errors.Unsupported, match="frame"):
        fleet.decode(captures, tmp_path / "dataset", tables=["frame"])
    assert not (tmp_path / "dataset").exists()


def run(*arguments: str, module: str = "polepair") -> subprocess.CompletedProcess[str]:
    words = ["fleet", *arguments] if module == "polepair" else list(arguments)
    return subprocess.run(
        [sys.executable, "-m", module, *words], capture_output=True, text=True, check=False, timeout=120
    )


def test_the_command_decodes_and_names_failures(captures: Path, dataset: Path, tmp_path: Path) -> None:
    folder, root = tmp_path / "captures", tmp_path / "dataset"
    shutil.copytree(captures, folder, copy_function=os.link)
    options = ("--as", "canopen", "--site", "hall-2")
    done = run("decode", str(folder), str(root), *options)
    assert (done.returncode, done.stdout) == (0, f"{CAPTURES} decoded, 0 were decoded earlier, 0 failed\n"), done.stderr
    assert content(root) == content(dataset)
    (folder / "broken.log").write_bytes(bytes(range(256)) * 40)
    again = run("decode", str(folder), str(root), *options, module="polepair.fleet")
    assert again.stdout == f"0 decoded, {CAPTURES} were decoded earlier, 1 failed\n"
    assert "failed: broken.log: " in again.stderr
    assert again.returncode == 1
    wrong = run("decode", str(tmp_path / "nowhere"), str(root))
    assert wrong.returncode == 2 and "there is no capture in" in wrong.stderr
    answer = run("sql", str(root), "select count(distinct file) from frames", "--csv")
    assert answer.stdout.splitlines()[1] == str(CAPTURES)
