"""Many threads and tasks on one link, on a bad line: each gets its own answer, or its own error."""

from __future__ import annotations

import asyncio
import os
import random
import threading
import time
from collections import Counter
from pathlib import Path

import polepair
import pytest

SECONDS = float(os.environ.get("POLEPAIR_MANY_SECONDS", "5"))
"""For each of the two; `make soak` asks for 300."""

THREADS = 200
TASKS = 1000

RACK = """
[[link]]
name = "bus"
kind = "can"
protocol = "tmcl"
faults = { error = 2e-3, lose = 2e-4 }
[[link.drive]]
profile = "tmcm-171"
address = 1
[[link.drive]]
profile = "tmcm-171"
address = 3
"""
"""Two modules on a bus that breaks and loses frames now and then.

It doubles none: a reply of this protocol names no parameter, so that a copy that comes behind the
next request cannot be told from its answer (REQ-6).
"""

SETTINGS = {"max positioning velocity": 4, "max current": 6, "reached velocity": 7, "acceleration": 11}
"""Settings that a module keeps, and their numbers."""


@pytest.fixture
def rack(tmp_path: Path) -> str:
    file = tmp_path / "rack.toml"
    file.write_text(RACK)
    return f"sim:{file}?timeout=100&seed=11"


class Book:
    """Record of the requests and their results."""

    def __init__(self) -> None:
        self.answers = 0
        self.errors: Counter[str] = Counter()
        self.wrong: list[str] = []
        self.lock = threading.Lock()

    def note(self, what: str, got: object, expected: object) -> None:
        with self.lock:
            self.answers += 1
            if got != expected:
                self.wrong.append(f"{what}: {got}, and it is {expected}")

    def fail(self, what: str, number: int, error: polepair.PolepairError) -> None:
        with self.lock:
            self.errors[error.code] += 1
            # An error names the axis that was asked, and what it was asked.
            if f"axis {number}" not in str(error) or what not in str(error):
                self.wrong.append(f"{what} of axis {number}: {error}")

    def judge(self, at_least: int) -> None:
        assert not self.wrong, self.wrong[:5]
        assert self.answers >= at_least
        # The line is bad, and most replies still arrive.
        assert sum(self.errors.values()) < self.answers / 10, self.errors


def worth(number: int, name: str) -> int:
    """Every setting of every axis has a value of its own."""
    return 10 + number * 10 + list(SETTINGS).index(name)


def asked(chance: random.Random, number: int) -> tuple[str, str, int]:
    """A request at random: how it is asked, its name in errors, and the answer that it must get."""
    name = chance.choice(list(SETTINGS))
    kind = chance.choice(["read", "read", "raw", "write"])
    what = f"GAP {SETTINGS[name]}, 0" if kind == "raw" else name
    return kind, what, worth(number, name)


def test_threads_share_a_link(rack: str) -> None:
    book, counts = Book(), [0] * THREADS
    with polepair.connect(rack) as link:
        prepare(link)
        ends = time.monotonic() + SECONDS

        def work(which: int) -> None:
            chance = random.Random(which)
            while time.monotonic() < ends or not counts[which]:
                axis = chance.choice(link.axes)
                kind, what, expected = asked(chance, axis.number)
                try:
                    if kind == "raw":
                        got = axis.raw(what)
                    elif kind == "read":
                        got = axis.params.raw[what]
                    else:
                        axis.params.raw[what] = got = expected
                    book.note(what, got, expected)
                except polepair.PolepairError as error:
                    book.fail(what, axis.number, error)
                counts[which] += 1

        threads = [threading.Thread(target=work, args=(which,)) for which in range(THREADS)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    book.judge(THREADS)
    assert min(counts) > 0


def test_tasks_share_a_link(rack: str) -> None:
    book, counts = Book(), [0] * TASKS

    async def main() -> None:
        async with await polepair.aio.connect(rack) as link:
            for axis in link.axes:
                for name in SETTINGS:
                    await settled(axis, name, worth(axis.number, name))
            ends = time.monotonic() + SECONDS

            async def work(which: int) -> None:
                chance = random.Random(which)
                while time.monotonic() < ends or not counts[which]:
                    axis = chance.choice(link.axes)
                    kind, what, expected = asked(chance, axis.number)
                    try:
                        if kind == "raw":
                            got = await axis.raw(what)
                        elif kind == "read":
                            got = await axis.params.get_raw(what)
                        else:
                            await axis.params.set_raw(what, expected)
                            got = expected
                        book.note(what, got, expected)
                    except polepair.PolepairError as error:
                        book.fail(what, axis.number, error)
                    counts[which] += 1

            await asyncio.gather(*(work(which) for which in range(TASKS)))

    asyncio.run(main())
    book.judge(TASKS)
    assert min(counts) > 0


def prepare(link: polepair.Link) -> None:
    """Gives each setting its value, however bad the line is."""
    for axis in link.axes:
        for name in SETTINGS:
            for _ in range(20):
                try:
                    axis.params.raw[name] = worth(axis.number, name)
                    break
                except polepair.NoReply:
                    continue
            else:
                pytest.fail(f"axis {axis.number} never took {name}")


async def settled(axis: polepair.aio.Axis, name: str, raw: int) -> None:
    for _ in range(20):
        try:
            return await axis.params.set_raw(name, raw)
        except polepair.NoReply:
            continue
    pytest.fail(f"axis {axis.number} never took {name}")


@pytest.mark.parametrize("pause", [0.0, 0.0005, 0.002, 0.01])
def test_a_cancelled_task_leaves_no_motor_running(pause: float) -> None:
    async def main() -> None:
        async with await polepair.aio.connect("sim:tmcl?time=virtual") as link:
            axis = link.axes[0]

            async def work() -> None:
                async with axis.armed():
                    await axis.spin(100, "rpm")
                    await asyncio.sleep(3600)

            task = asyncio.create_task(work())
            while not link.simulation.truth().enabled:
                await asyncio.sleep(pause)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            link.simulation.run(3.0)
            truth = link.simulation.truth()
            assert not truth.enabled and abs(truth.velocity) < 0.1

    asyncio.run(main())
