"""Starts our simulated drives for programs that other people wrote."""

import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest
from odd_canopen import OddDrive
from polepair_test_support import MAX_WAIT, first_line, machine_load

# A shell ignores Ctrl+C in programs that it starts in the background, and they pass that on to theirs.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
ROOT = Path(__file__).resolve().parent.parent
TARGET = ROOT / "target" / os.environ.get("POLEPAIR_BUILD", "debug")
POLEPAIR = TARGET / "polepair"
EXAMPLES = TARGET / "examples"
# Long enough time-outs for a machine that is busy with other things; programs that tests start inherit it.
os.environ.setdefault("POLEPAIR_TIMEOUT_SCALE", "10")
BUILD = Path(__file__).resolve().parent / "build"


def start(*words):
    """`polepair sim …` and the line it prints when it can be used."""
    process = subprocess.Popen(
        [POLEPAIR, "sim", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    line = first_line(f"the ready line of `sim {' '.join(words)}`", process)
    if not line.startswith("ready "):
        process.kill()
        raise AssertionError(f"no ready line: {line!r} {process.communicate()[1]!r}; {machine_load()}")
    return process, line.split()[1]


def end(process):
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=MAX_WAIT) == 0, process.stderr.read()


@pytest.fixture
def sim(tmp_path):
    """A function that starts a drive on a pty and gives the path that a client opens."""
    running = []

    def drive(words):
        path = tmp_path / f"pty{len(running)}"
        process, _ = start(words, "--pty", str(path))
        running.append(process)
        assert path.is_symlink()
        return str(path)

    yield drive
    for process in running:
        end(process)


@pytest.fixture
def odd():
    """A function that makes an odd CiA 402 drive; all end with the test."""
    drives = []

    def drive(**options):
        drives.append(OddDrive(**options))
        return drives[-1]

    yield drive
    for one in drives:
        one.close()


def polepair(*words, check=True, timeout=120, silence=False):
    """One run of the command line. Where it waits for somebody who is silent on purpose, `silence` has it
    wait twice as long as it does for a user."""
    scale = "2" if silence else os.environ["POLEPAIR_TIMEOUT_SCALE"]
    done = subprocess.run(
        [POLEPAIR, *words], capture_output=True, text=True, timeout=timeout, check=False,
        env={**os.environ, "POLEPAIR_TIMEOUT_SCALE": scale},
    )
    if check:
        assert done.returncode == 0, f"{words}: {done.returncode}\n{done.stdout}{done.stderr}"
    return done


def occurs_within(seconds, condition):
    """Returns whether a condition becomes true within a duration. `wait_until` is for what has to occur."""
    end_at = time.monotonic() + seconds
    while time.monotonic() < end_at:
        if condition():
            return True
        time.sleep(0.02)
    return False


def need(program):
    """Skips where a program is not installed, and says so."""
    if shutil.which(program) is None:
        pytest.skip(f"{program} is not installed")


def compiled(source, *libraries):
    """A C program of this folder, compiled with pkg-config's flags."""
    need("gcc")
    need("pkg-config")
    if subprocess.run(["pkg-config", "--exists", *libraries], check=False).returncode:
        pytest.skip(f"{' '.join(libraries)} is not installed")
    flags = subprocess.run(
        ["pkg-config", "--cflags", "--libs", *libraries], capture_output=True, text=True, check=True
    ).stdout.split()
    BUILD.mkdir(exist_ok=True)
    program = BUILD / Path(source).stem
    here = Path(__file__).resolve().parent / source
    if not program.exists() or os.stat(program).st_mtime < os.stat(here).st_mtime:
        subprocess.run(["gcc", "-O2", "-Wall", str(here), "-o", str(program), *flags], check=True)
    return str(program)
