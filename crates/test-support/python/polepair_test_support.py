"""Waits of the Python tests: for a condition, never for a duration.

Used by the tests of the package and by `interop`; the Rust tests have the crate `polepair-test-support`.
"""

from __future__ import annotations

import os
import select
import subprocess
import time
from collections.abc import Callable
from typing import NoReturn, TypeVar

Value = TypeVar("Value")

# Longest wait for a condition, s. Only a failed test waits so long.
MAX_WAIT = 120.0


def wait_until(
    what: str,
    read: Callable[[], Value],
    accepts: Callable[[Value], object] = bool,
    *,
    interval: float = 0.02,
) -> Value:
    """Returns the first value that `read` gives and `accepts` accepts; reads every `interval` seconds.

    Fails after `MAX_WAIT` with what was waited for, the last value, and the load of the machine.
    """
    began = time.monotonic()
    while not accepts(value := read()):
        if time.monotonic() - began > MAX_WAIT:
            fail_wait(what, began, value)
        time.sleep(interval)
    return value


def first_line(what: str, process: subprocess.Popen[str]) -> str:
    """Returns the first line that a process prints; empty if it ended without one.

    Kills a process that prints nothing for `MAX_WAIT`, and fails.
    """
    assert process.stdout is not None
    began = time.monotonic()
    if not select.select([process.stdout], [], [], MAX_WAIT)[0]:
        process.kill()
        fail_wait(what, began, "no output")
    return process.stdout.readline()


def fail_wait(what: str, began: float, seen: object) -> NoReturn:
    """Fails the test: `began` is when the wait began, in the time of `time.monotonic`."""
    waited = time.monotonic() - began
    raise AssertionError(f"waited {waited:.0f} s for: {what}; seen: {seen!r}; {machine_load()}")


def machine_load() -> str:
    """How busy the machine is."""
    load = " ".join(f"{average:.2f}" for average in os.getloadavg())
    return f"load {load} on {os.cpu_count()} processors"
