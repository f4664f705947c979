"""The programs in `examples/python` do what those in `examples/rust` do."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from served import POLEPAIR

EXAMPLES = Path(__file__).parents[3] / "examples"
EXPECTED = {
    name: parts.split(" | ")
    for name, parts in (
        line.split(": ", 1) for line in (EXAMPLES / "expected.txt").read_text().splitlines()
    )
}


def run(name: str, *words: str) -> str:
    program = [sys.executable, str(EXAMPLES / "python" / f"{name}.py"), *words]
    done = subprocess.run(program, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def in_order(name: str) -> re.Pattern[str]:
    return re.compile(".*".join(re.escape(part) for part in EXPECTED[name]), re.DOTALL)


@pytest.mark.parametrize("name", EXPECTED)
def test_it_runs_on_simulated_drives(name: str) -> None:
    assert in_order(name).search(run(name))


@pytest.mark.parametrize("name", ["parameters", "spin", "watch"])
def test_it_runs_on_a_real_port(name: str, tmp_path: Path) -> None:
    path = str(tmp_path / "drive")
    simulator = subprocess.Popen(
        [POLEPAIR, "sim", "tmcl:1,3", "--pty", path], stdout=subprocess.PIPE, text=True
    )
    try:
        assert simulator.stdout is not None
        assert simulator.stdout.readline().startswith("ready ")
        axes = "#1,3" if name == "watch" else "#1"
        url = f"tmcl+serial://{os.fspath(path)}{axes}"
        assert in_order(name).search(run(name, url))
    finally:
        simulator.terminate()
        simulator.wait(timeout=120)


def test_there_are_the_same_in_rust() -> None:
    for name in EXPECTED:
        assert (EXAMPLES / "rust" / f"{name}.rs").is_file()
    assert sorted(p.stem for p in (EXAMPLES / "python").glob("*.py")) == sorted(EXPECTED)
