"""Many threads and tasks on one link: each gets its own answer."""

from __future__ import annotations

import asyncio
import os
import random
import threading
import time

import polepair
import pytest

SECONDS = float(os.environ.get("POLEPAIR_MANY_SECONDS", "2"))


def names(axis: polepair.Axis) -> dict[str, int]:
    """Settings that were each given a value of its own."""
    values = {}
    for at, name in enumerate(["max current", "standby current"]):
        try:
            axis.params.raw[name] = 10 + at
            values[name] = 10 + at
        except polepair.PolepairError:
            continue
    assert values
    return values


def test_two_hundred_threads_share_a_link() -> None:
    wrong: list[str] = []
    counts = [0] * 200
    with polepair.connect("sim:tmcl+can") as link:
        axis = link.axes[0]
        values = names(axis)
        ends = time.monotonic() + SECONDS

        def work(which: int) -> None:
            chance = random.Random(which)
            while time.monotonic() < ends:
                name = chance.choice(list(values))
                got = axis.params.raw[name]
                if got != values[name]:
                    wrong.append(f"{name}: {got}")
                counts[which] += 1

        threads = [threading.Thread(target=work, args=(which,)) for which in range(200)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert not wrong
    assert min(counts) > 0


def test_a_thousand_tasks_share_a_link() -> None:
    async def main() -> int:
        async with await polepair.aio.connect("sim:tmcl+can") as link:
            axis = link.axes[0]
            await axis.params.set_raw("max current", 11)
            ends = time.monotonic() + SECONDS
            count = 0

            async def work() -> None:
                nonlocal count
                while True:
                    assert await axis.params.get_raw("max current") == 11
                    count += 1
                    if time.monotonic() >= ends:
                        return

            await asyncio.gather(*(work() for _ in range(1000)))
            return count

    assert asyncio.run(main()) >= 1000


def test_a_cancelled_task_leaves_no_motor_running() -> None:
    async def main() -> None:
        async with await polepair.aio.connect("sim:tmcl?time=virtual") as link:
            axis = link.axes[0]

            async def work() -> None:
                async with axis.armed():
                    await axis.spin(100, "rpm")
                    await asyncio.sleep(3600)

            task = asyncio.create_task(work())
            while not link.simulation.truth().enabled:
                await asyncio.sleep(0.01)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            link.simulation.run(3.0)
            truth = link.simulation.truth()
            assert not truth.enabled and abs(truth.velocity) < 0.1

    asyncio.run(main())


def test_ctrl_c_ends_a_wait() -> None:
    import signal
    import subprocess
    import sys

    program = (
        "import polepair\n"
        "with polepair.connect('sim:tmcl') as link:\n"
        "    print('ready', flush=True)\n"
        "    link.sleep(3600)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert "KeyboardInterrupt" in errors
