"""Signals, threads and ends of the interpreter: what is armed is stopped first."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import polepair
import pytest
from served import POLEPAIR

ENDS = ["SIGTERM", "SIGHUP", "SIGQUIT", "SIGVTALRM", "SIGXCPU", "SIGABRT", "SIGSYS"]

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
ARMING = """
import sys, polepair
with polepair.connect(sys.argv[1]) as link:
    print("ready", flush=True)
    while True:
        with link.axes[0].armed() as axis:
            axis.spin(300, "rpm")
"""
RESUMED = BLOCK.replace("time.sleep(3600)", """sys.stdin.readline()
            try:
                axis.spin(300, "rpm")
            except polepair.PolepairError as error:
                print(type(error).__name__)
""") + "turn(sys.argv[1])"
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


ENDING = BLOCK.replace("time.sleep(3600)", """sys.stdin.readline()
        print("ended", flush=True)
""") + "turn(sys.argv[1])"
CLOSED = """
import sys, threading, polepair
link = polepair.connect(sys.argv[1])
with link.axes[0].armed() as axis:
    axis.spin(300, "rpm")
    print("ready", flush=True)
    sys.stdin.readline()
    ends = threading.Timer(0.5, link.close)
    ends.start()
ends.join()
"""


@pytest.fixture(autouse=True, scope="module")
def _signals_as_ever() -> Iterator[None]:
    """Restores the signals that a shell ignores for background jobs: each program here would inherit that."""
    names = [*ENDS, "SIGINT"]
    ignored = [signal.Signals[name] for name in names]
    ignored = [each for each in ignored if signal.getsignal(each) == signal.SIG_IGN]
    for each in ignored:
        signal.signal(each, signal.SIG_DFL)
    yield
    for each in ignored:
        signal.signal(each, signal.SIG_IGN)


class Wire:
    """A TCP wire to a drive that falls silent on demand: bytes sent meanwhile are lost."""

    def __init__(self, drive: tuple[str, int]) -> None:
        self.silent = threading.Event()
        self._drive = drive
        self._listener = socket.create_server(("127.0.0.1", 0))
        threading.Thread(target=self._serve, daemon=True).start()

    @property
    def url(self) -> str:
        return "tmcl+tcp://{}:{}#1".format(*self._listener.getsockname()[:2])

    def _serve(self) -> None:
        while True:
            host, _ = self._listener.accept()
            drive = socket.create_connection(self._drive)
            for one, other in (host, drive), (drive, host):
                threading.Thread(target=self._pass, args=(one, other), daemon=True).start()

    def _pass(self, one: socket.socket, other: socket.socket) -> None:
        try:
            while heard := one.recv(4096):
                if not self.silent.is_set():
                    other.sendall(heard)
        except OSError:
            pass
        finally:
            with contextlib.suppress(OSError):
                other.shutdown(socket.SHUT_RDWR)


@pytest.fixture
def wire() -> Iterator[Wire]:
    """A drive on TCP, which outlives the program that turns it."""
    simulator = subprocess.Popen(
        [POLEPAIR, "sim", "tmcl:1", "--tcp", "127.0.0.1:0"], stdout=subprocess.PIPE, text=True
    )
    assert simulator.stdout is not None
    line = simulator.stdout.readline()
    assert line.startswith("ready ")
    host, _, port = line.split("//")[1].split("#")[0].split("?")[0].strip().rpartition(":")
    yield Wire((host, int(port)))
    simulator.terminate()
    simulator.wait(timeout=120)


@pytest.fixture
def url(tmp_path: Path) -> Iterator[str]:
    """A drive that outlives the program which turns it."""
    simulator = subprocess.Popen(
        [POLEPAIR, "sim", "tmcl:1", "--pty", str(tmp_path / "drive")],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert simulator.stdout is not None
    line = simulator.stdout.readline()
    assert line.startswith("ready ")
    yield line.removeprefix("ready ").strip()
    simulator.terminate()
    simulator.wait(timeout=120)


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


@pytest.mark.parametrize("name", ENDS)
@pytest.mark.parametrize("program", [MAIN, THREAD, LOOP], ids=["main", "thread", "loop"])
def test_a_signal_that_ends_the_process_stops_first(program: str, name: str, url: str) -> None:
    number = signal.Signals[name]
    process = begun(program, url)
    process.send_signal(number)
    process.communicate(timeout=120)
    # It ends as it would without us.
    assert process.returncode == -number
    stands(url)


@pytest.mark.parametrize("after", [0.0, 0.002, 0.005, 0.01, 0.02, 0.05])
def test_a_signal_ends_the_process_as_ever_while_it_arms(after: float, url: str) -> None:
    process = begun(ARMING, url)
    time.sleep(after)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=120)
    assert process.returncode == -signal.SIGTERM
    # It may not have been armed once: a module of this kind has its driver on from the beginning.
    with polepair.connect(url) as link:
        assert link.axes[0].params.raw["target velocity"] == 0


def ends_on_a_silent_wire(program: str, wire: Wire) -> subprocess.Popen[str]:
    """The program, whose block ends while its wire is silent."""
    process = begun(program, wire.url)
    wire.silent.set()
    assert process.stdin is not None
    process.stdin.write("\n")
    process.stdin.flush()
    time.sleep(0.5)
    assert process.poll() is None, "its stop is pending"
    return process


@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT"])
def test_a_signal_while_a_block_ends_waits_for_its_stop(name: str, wire: Wire) -> None:
    process = ends_on_a_silent_wire(ENDING, wire)
    process.send_signal(signal.Signals[name])
    time.sleep(1.0)
    assert process.poll() is None, "its stop is pending"
    wire.silent.clear()
    said, told = process.communicate(timeout=120)
    assert "polepair: " not in told, told
    # A process that ran on after the end of the block was ended there.
    assert process.returncode == -signal.Signals[name] and said in ("", "ended\n")
    stands(wire.url)


def test_a_link_that_is_closed_while_its_stop_is_pending_ends_that(wire: Wire) -> None:
    process = ends_on_a_silent_wire(CLOSED, wire)
    _, told = process.communicate(timeout=120)
    assert process.returncode == 1 and "may still turn" in told, told


def test_ctrl_z_stops_and_suspends(url: str) -> None:
    process = begun(MAIN, url)
    process.send_signal(signal.SIGTSTP)
    _, status = os.waitpid(process.pid, os.WUNTRACED)
    assert os.WIFSTOPPED(status)
    # It was stopped before, not by its end, which nothing tells it.
    process.kill()
    process.communicate(timeout=120)
    stands(url)


def test_a_process_resumed_after_ctrl_z_is_not_armed(url: str) -> None:
    process = begun(RESUMED, url)
    for _ in range(2):
        process.send_signal(signal.SIGTSTP)
        _, status = os.waitpid(process.pid, os.WUNTRACED)
        assert os.WIFSTOPPED(status)
        process.send_signal(signal.SIGCONT)
    said, _ = process.communicate("\n", timeout=120)
    assert said == "Unsupported\n"
    stands(url)


def test_a_link_that_is_closed_stops_what_is_armed(url: str) -> None:
    link = polepair.connect(url)
    armed = link.axes[0].armed()
    armed.__enter__().spin(300, "rpm")
    link.close()
    stands(url)


def test_a_block_of_a_link_stops_what_is_armed(url: str) -> None:
    with polepair.connect(url) as link:
        link.axes[0].armed().__enter__().spin(300, "rpm")
    stands(url)


@pytest.mark.parametrize("awaited", [False, True], ids=["entered", "awaited"])
def test_a_block_of_a_loop_stops_what_is_armed(awaited: bool, url: str) -> None:
    async def main() -> int:
        opening = polepair.aio.connect(url)
        looked = 0

        async def look() -> None:
            nonlocal looked
            while True:
                await asyncio.sleep(0.01)
                looked += 1

        async with await opening if awaited else opening as link:
            axis = await link.axes[0].armed().__aenter__()
            await axis.spin(300, "rpm")
            await asyncio.sleep(0.3)
            looking = asyncio.ensure_future(look())
        looking.cancel()
        return looked

    # The loop goes on meanwhile.
    assert asyncio.run(main()) >= 3
    stands(url)


@pytest.mark.parametrize("program", [MAIN, LOOP], ids=["main", "loop"])
def test_ctrl_c_ends_the_block(program: str, url: str) -> None:
    process = begun(program, url)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=120)
    stands(url)


def test_daemon_threads_leave_no_motor_turning(url: str) -> None:
    process = begun(DAEMON, url)
    process.communicate("\n", timeout=120)
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
        # The motion of the first block continues.
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
