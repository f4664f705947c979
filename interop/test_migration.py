"""The programs of docs/guides/migration.md, theirs and ours, show the same values."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT, end, start
from polepair_test_support import MAX_WAIT

PAGE = ROOT / "docs" / "guides" / "migration.md"
GROUP, PORT = "239.74.163.2", 44_200 + os.getpid() % 1000
# The drive that each library's programs are written for.
DRIVES = {"PyTrinamic": "tmcl:1", "pymodbus": "modbus-rtu:1", "canopen": "cia402:2", "TML_LIB": "tml:1"}


def programs():
    """Library, title, and the blocks below it: language and text."""
    for chapter in PAGE.read_text().split("\n## ")[1:]:
        library, *parts = re.split(r"\n### ", chapter)
        for part in parts:
            title = part.splitlines()[0]
            blocks = re.findall(r"```(\w+)\n(.*?)```", part, re.DOTALL)
            yield pytest.param(library.splitlines()[0], blocks, id=f"{library.split()[0]}: {title}")


def test_each_library_has_five():
    titles = [param.id.split(":")[0] for param in programs()]
    assert {name: titles.count(name) for name in DRIVES} == dict.fromkeys(DRIVES, 5)


@pytest.fixture
def run(tmp_path):
    """Runs a program against a drive as new, and gives what it prints."""

    def run(library, program):
        path = str(tmp_path / "drive")
        place = ("--udp", f"{GROUP}:{PORT}") if library == "canopen" else ("--pty", path)
        simulator, _ = start(DRIVES[library], *place)
        theirs = f'interface="udp_multicast", channel="{GROUP}", port={PORT}'
        program = program.replace("/dev/ttyUSB0", path)
        program = program.replace('interface="socketcan", channel="can0"', theirs)
        program = program.replace("socketcan://can0", f"udp://{GROUP}:{PORT}")
        file = tmp_path / "program.py"
        file.write_text(program)
        try:
            done = subprocess.run(
                [sys.executable, file], capture_output=True, text=True, timeout=MAX_WAIT, check=False
            )
        finally:
            end(simulator)
        assert done.returncode == 0, f"{program}\n{done.stdout}{done.stderr}"
        return done.stdout

    return run


NUMBER = re.compile(r"-?(?:0x[0-9A-Fa-f]+|\d+(?:\.\d+)?)")


def same(one, other):
    """The words are, and numbers are within two in a hundred: motors are not exact."""
    numbers = [[int(n, 16) if "x" in n else float(n) for n in NUMBER.findall(t)] for t in (one, other)]
    words = [NUMBER.sub("#", text).split() for text in (one, other)]
    return words[0] == words[1] and numbers[0] == pytest.approx(numbers[1], rel=0.02, abs=0.01)


@pytest.mark.parametrize(("library", "blocks"), programs())
def test_ours_shows_what_theirs_shows(run, library, blocks):
    languages = [language for language, _ in blocks]
    if library == "TML_LIB":
        # TML_LIB is a closed library: the page contains the output of ours.
        assert languages == ["c", "python", "text"]
        theirs, ours = blocks[2][1], run(library, blocks[1][1])
    else:
        assert languages == ["python", "python"]
        theirs, ours = (run(library, program) for _, program in blocks)
    assert theirs and same(theirs, ours), f"theirs:\n{theirs}ours:\n{ours}"
