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

# Their time-outs, s, are too short for a busy machine, even where no bus is involved. Each of these
# texts is in their tests, and is replaced.
PATIENCE = {
    "PERIOD * 10": "PERIOD * 300",
    "TIMEOUT = 0.1\n": "TIMEOUT = 3.0\n",
    "threading.Timer(0.01,": "threading.Timer(1.0,",
    "wait_for_heartbeat(0.1)": "wait_for_heartbeat(3.0)",
    "time.sleep(0.1)": "time.sleep(2.0)",
    "time.sleep(0.2)": "time.sleep(2.0)",
    "recv(1)": "recv(30)",
}

# Runs inside of their suite: their interface's name means ours.
PLUGIN = '''
import can.interface
from canopen.sdo import SdoClient
from polepair.can import Bus

SdoClient.RESPONSE_TIMEOUT = 5
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
    be_patient((BUILD / name / "test").glob("test_*.py"))
    (BUILD / name / "polepair_buses.py").write_text(PLUGIN)
    return BUILD / name


def be_patient(files):
    unseen = set(PATIENCE)
    for file in files:
        text = file.read_text()
        unseen -= {short for short in PATIENCE if short in text}
        for short, long in PATIENCE.items():
            text = text.replace(short, long)
        file.write_text(text)
    assert not unseen, f"their tests are others now: {unseen}"


def test_their_tests_pass_on_our_buses(suite):
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "polepair_buses", "test"],
        cwd=suite, capture_output=True, text=True, timeout=1200, check=False,
    )
    told = done.stdout + done.stderr
    assert done.returncode == 0, told[-4000:]
    tests = int(re.search(r"(\d+) passed", told)[1])
    buses = int(re.search(r"buses of polepair: (\d+)", told)[1])
    assert tests >= 170 and buses >= 50, told[-500:]
