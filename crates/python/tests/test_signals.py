"""Signals, threads and ends of the interpreter: what is armed is stopped first."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import polepair
import pytest

BINARY = Path(__file__).parents[3] / "target" / "release" / "polepair"

if sys.platform == "win32":
    pytest.skip("signals as Unix has them", allow_module_level=True)

BLOCK = """
import threading, time, sys, polepair
def turn(url):
    with polepair.connect(url) as link:
        axis = link.axes[0]
        with axis.armed():
            axis.spin(300, "rpm")
            print("ready", flush=True)
            time.sleep(3600)
"""
MAIN = BLOCK + "turn(sys.argv[1])"
THREAD = BLOCK + """
turning = threading.Thread(target=turn, args=sys.argv[1:])
turning.start()
turning.join()
"""
DAEMON = BLOCK + """
threading.Thread(target=turn, args=sys.argv[1:], daemon=True).start()
sys.stdin.readline()
"""
LOOP = """
import asyncio, sys, polepair
async def turn(url):
    async with polepair.aio.connect(url) as link:
        axis = link.axes[0]
        async with axis.armed():
            await axis.spin(300, "rpm")
            print("ready", flush=True)
            await asyncio.sleep(3600)
asyncio.run(turn(sys.argv[1]))
"""


@pytest.fixture
def url(tmp_path: Path) -> Iterator[str]:
    """A drive that outlives the program which turns it."""
    simulator = subprocess.Popen(
        [BINARY, "sim", "tmcl:1", "--pty", str(tmp_path / "drive")],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert simulator.stdout is not None
    line = simulator.stdout.readline()
    assert line.startswith("ready ")
    yield line.removeprefix("ready ").strip()
    simulator.terminate()
    simulator.wait(timeout=30)


def begun(program: str, url: str) -> subprocess.Popen[str]:
    """The program, once the motor turns."""
    process = subprocess.Popen(
        [sys.executable, "-c", program, url],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def stands(url: str) -> None:
    with polepair.connect(url) as link:
        axis = link.axes[0]
        assert axis.params.raw["target velocity"] == 0
        assert axis.params.raw["driver enable"] == 0


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGQUIT"])
@pytest.mark.parametrize("program", [MAIN, THREAD, LOOP], ids=["main", "thread", "loop"])
def test_a_signal_that_ends_the_process_stops_first(program: str, name: str, url: str) -> None:
    number = signal.Signals[name]
    process = begun(program, url)
    process.send_signal(number)
    process.communicate(timeout=60)
    # It ends as it would without us.
    assert process.returncode == -number
    stands(url)


@pytest.mark.parametrize("program", [MAIN, LOOP], ids=["main", "loop"])
def test_ctrl_c_ends_the_block(program: str, url: str) -> None:
    process = begun(program, url)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    stands(url)


def test_daemon_threads_leave_no_motor_turning(url: str) -> None:
    process = begun(DAEMON, url)
    process.communicate("\n", timeout=60)
    assert process.returncode == 0
    stands(url)


def test_a_forks_child_ends_by_signals_as_ever(axis: polepair.Axis) -> None:
    with axis.armed():
        reads, writes = os.pipe()
        child = os.fork()
        if child == 0:
            os.write(writes, b".")
            signal.pause()
            os._exit(0)
        os.read(reads, 1)
        os.kill(child, signal.SIGTERM)
        assert os.waitpid(child, 0)[1] == signal.SIGTERM
        assert axis._native.is_armed
        os.close(reads)
        os.close(writes)


def test_an_armed_axis_is_not_armed_again(axis: polepair.Axis) -> None:
    with axis.armed():
        axis.spin(10)
        with pytest.raises(polepair.Unsupported) as refused, axis.armed():
            pass
        assert refused.value.code == "E220"
        # What the first block does goes on.
        axis._native.sleep(0.5)
        assert abs(axis.read("velocity")["velocity"]) > 5
    with axis.armed():
        pass


def test_an_armed_axis_is_not_armed_again_in_a_loop() -> None:
    async def main() -> None:
        async with polepair.aio.connect("sim:tmcl?time=virtual") as link:
            axis = link.axes[0]
            async with axis.armed():
                with pytest.raises(polepair.Unsupported):
                    async with axis.armed():
                        pass
                assert axis._native.is_armed

    asyncio.run(main())
