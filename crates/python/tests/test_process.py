"""Processes: Ctrl-C, forks, pickles, notebooks, and that nothing leaks."""

from __future__ import annotations

import gc
import os
import pickle
import signal
import subprocess
import sys
import time
from pathlib import Path

import polepair
import pytest

CALLS = int(os.environ.get("POLEPAIR_LEAK_CALLS", "50000"))


def interrupted(program: str) -> str:
    """Runs a program, presses Ctrl-C once it is ready, and gives what it says of it."""
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    return errors


@pytest.mark.parametrize(
    "wait",
    [
        "link.sleep(3600)",
        "axis.step('velocity', 1, seconds=3600)",
        "axis.move(1e4); axis.reached(3600)",
    ],
)
def test_ctrl_c_ends_a_wait(wait: str) -> None:
    program = f"""
import polepair
with polepair.connect('sim:tmcl') as link:
    axis = link.axes[0]
    with axis.armed():
        print('ready', flush=True)
        {wait}
"""
    assert "KeyboardInterrupt" in interrupted(program)


def test_a_forks_child_gets_an_error(link: polepair.Link, axis: polepair.Axis) -> None:
    reads, writes = os.pipe()
    child = os.fork()
    if child == 0:
        said = []
        for use in (
            lambda: axis.params["max current"], lambda: axis.raw("GAP 6"), link.stop,
            lambda: link.axis(1), lambda: link.simulation.truth(), axis.enable,
        ):
            try:
                use()
                said.append("nothing")
            except polepair.Unsupported as error:
                said.append(error.code)
        with polepair.connect("sim:tmcl?time=virtual") as own:
            said.append(str(own.axes[0].raw("GAP 6, 0")))
        os.write(writes, " ".join(said).encode())
        # An inherited link ends with the process, and waits for no thread that is not here.
        link.close()
        del axis
        gc.collect()
        os.write(writes, b" gone")
        os._exit(0)
    os.close(writes)
    with os.fdopen(reads) as pipe:
        said = pipe.read()
    assert os.waitpid(child, 0)[1] == 0
    assert said.startswith("E224 " * 6) and said.endswith(" gone")
    # The parent goes on.
    assert axis.raw("GAP 6, 0") >= 0


def test_an_open_object_cannot_be_pickled(link: polepair.Link, axis: polepair.Axis) -> None:
    for what in (link, axis):
        with pytest.raises(TypeError, match="connection string"):
            pickle.dumps(what)


def test_objects_show_themselves(link: polepair.Link, axis: polepair.Axis) -> None:
    assert "sim:tmcl" in repr(link) and "TMCM-171" in link._repr_html_()
    assert "armed" in axis._repr_html_() and "&lt;" not in axis._repr_html_()
    current = axis.params["max current"]
    assert f'title="raw {current.raw}"' in current._repr_html_()
    with axis.armed():
        trace = axis.capture(["position", "velocity"], rate=50, seconds=0.2)
    assert "position, velocity" in repr(trace) and trace._repr_html_().count("<svg") == 2
    assert polepair.Quantity(1.0, "<b>")._repr_html_().count("<b>") == 1


def resident() -> int:
    """Bytes of memory that this process holds."""
    pages = Path("/proc/self/statm").read_text().split()[1]
    return int(pages) * os.sysconf("SC_PAGESIZE")


def test_a_million_calls_leak_nothing(tmp_path: Path) -> None:
    file = tmp_path / "one.log"
    file.write_text("(1.000000) can0 602#4064600000000000\n" * 20)
    calls = 0

    def round_of_calls(axis: polepair.Axis) -> int:
        axis.params.raw["max current"] = 10
        assert axis.params["max current"].raw == axis.raw("GAP 6, 0") == 10
        axis.read("position")
        with pytest.raises(polepair.Unsupported):
            axis.params.raw["nonsense"]
        polepair.explain("tmcl", polepair.encode("tmcl", "ROR 0, 350", axis=1))
        return 7

    def open_and_decode() -> int:
        capture = polepair.decode(file, protocols="canopen")
        assert len(list(capture)) == len(capture.frames.to_numpy()["seq"]) == 20
        with polepair.connect("sim:tmcl?time=virtual") as other:
            assert other.axes
        return 4

    with polepair.connect("sim:tmcl+can?time=virtual") as link:
        axis = link.axes[0]

        def work(until: int) -> int:
            nonlocal calls
            while calls < until:
                for _ in range(100):
                    calls += round_of_calls(axis)
                calls += open_and_decode()
            gc.collect()
            return resident()

        # By then every cache is filled.
        before = work(CALLS // 2)
        after = work(CALLS)
    # The limit finds 17 bytes a call in a million calls (make soak), 340 in fifty thousand.
    assert after - before < 8 << 20, f"{after - before} bytes more after {CALLS // 2} calls"
