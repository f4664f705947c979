"""python canopen's own tests, every bus of theirs being one of ours.

They are not installed with it, so they come from its source distribution, of the very version that
is installed.
"""

import re
import subprocess
import sys
import tarfile
from importlib.metadata import version

import pytest
from conftest import BUILD

# Their patience is 0.3 s, even where no bus is involved: who fails on a busy machine tries again.
TRIES_MAX = 3

# Runs inside of their suite: their interface's name means ours.
PLUGIN = '''
import can.interface
from polepair.can import Bus

can.interface.BACKENDS["virtual"] = ("polepair.can", "Bus")
opened = []
inner = Bus.__init__


def counted(self, *args, **kwargs):
    opened.append(self)
    inner(self, *args, **kwargs)


Bus.__init__ = counted


def pytest_terminal_summary(terminalreporter):
    terminalreporter.write_line(f"buses of polepair: {len(opened)}")
'''


@pytest.fixture(scope="module")
def suite():
    """Their tests, unpacked."""
    BUILD.mkdir(exist_ok=True)
    name = f"canopen-{version('canopen')}"
    archive = BUILD / f"{name}.tar.gz"
    if not archive.exists():
        words = ["download", "--quiet", "--no-deps", "--no-binary", "canopen", "--dest", str(BUILD)]
        done = subprocess.run(
            [sys.executable, "-m", "pip", *words, f"canopen=={version('canopen')}"],
            capture_output=True, text=True, timeout=600, check=False,
        )
        if done.returncode:
            pytest.skip(f"no source distribution of {name}: {done.stderr.strip()[-200:]}")
    with tarfile.open(archive) as packed:
        # The tests alone: the package that is tried is the one that is installed.
        tests = [part for part in packed.getmembers() if part.name.startswith(f"{name}/test/")]
        packed.extractall(BUILD, members=tests, filter="data")
    (BUILD / name / "polepair_buses.py").write_text(PLUGIN)
    return BUILD / name


def run(suite, *words):
    """Whether they pass, and what is told of it."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "polepair_buses", *words, "test"],
        cwd=suite, capture_output=True, text=True, timeout=1200, check=False,
    )
    return done.returncode == 0, done.stdout + done.stderr


def test_their_tests_pass_on_our_buses(suite):
    passed, first = run(suite, "--cache-clear")
    told = first
    for _ in range(TRIES_MAX):
        if not passed:
            passed, told = run(suite, "--last-failed")
    assert passed, told[-4000:]
    tests = sum(int(count) for count in re.findall(r"(\d+) (?:passed|failed)", first))
    buses = int(re.search(r"buses of polepair: (\d+)", first)[1])
    assert tests >= 170 and buses >= 50, first[-500:]
