"""Helpers for tests of a running server: the real `polepair serve`, and views of it."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import polepair
import pytest
from polepair_test_support import first_line, wait_until

ROOT = Path(__file__).resolve().parents[3]
POLEPAIR = ROOT / "target" / os.environ.get("POLEPAIR_BUILD", "debug") / "polepair"


class Server:
    """A server of its own for each test, on a free port."""

    def __init__(
        self,
        folder: Path,
        *options: str,
        drives: str = "sim:tmcl?axes=2",
        bind: str = "127.0.0.1:0",
    ) -> None:
        self.tokens = folder / "tokens"
        self.child = subprocess.Popen(
            [
                str(POLEPAIR), "serve", drives, "--bind", bind, "--log", "off",
                "--state", str(folder), *options,
            ],
            stdout=subprocess.PIPE,
            text=True,
        )
        line = first_line("the ready line of the server", self.child)
        assert line.startswith("ready "), line
        self.url = line.split()[1].split("/?")[0]

    @property
    def ws(self) -> str:
        return self.url.replace("http", "ws", 1)

    def join(self) -> polepair.Link:
        return polepair.connect(self.ws, token_file=self.tokens)

    def kill(self) -> None:
        self.child.kill()
        self.child.wait()


@pytest.fixture
def own_server(tmp_path: Path) -> Iterator[Server]:
    """One that each test has for itself; it goes by the name that a test's file gives it."""
    served = Server(tmp_path)
    yield served
    served.kill()


@pytest.fixture
def joined_link(server: Server) -> Iterator[polepair.Link]:
    """A link to that server."""
    with server.join() as joined:
        yield joined


def speed(axis: polepair.Axis) -> float:
    return abs(axis.read("velocity")["velocity"])


def wait_for_rotation(axis: polepair.Axis, rad_per_s: float = 10.0) -> None:
    wait_until("the motor turns", lambda: speed(axis), lambda now: now > rad_per_s)


def wait_for_standstill(axis: polepair.Axis) -> None:
    wait_until("the motor stands still", lambda: speed(axis), lambda now: now < 0.5)


def wait_for_disarmed(axis: polepair.Axis) -> None:
    wait_until("the axis is no longer armed", lambda: not axis._native.is_armed)


def can_be_armed(axis: polepair.Axis) -> bool:
    try:
        with axis.armed():
            return True
    except polepair.PolepairError as error:
        assert error.code in ("gateway.busy", "gateway.lease", "gateway.pending"), error
        return False
