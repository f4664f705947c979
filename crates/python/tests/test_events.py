"""Events without a request, for threads and for event loops."""

from __future__ import annotations

import asyncio
import queue
import signal
import subprocess
import sys
import threading
import time

import polepair
import pytest
from polepair import events
from polepair.events import (
    ArmedChanged,
    FaultAppeared,
    Happening,
    ParameterSent,
    PresenceChanged,
    SignalSent,
)

NODE = "sim:cia402:2?time=virtual"


def sending(link: polepair.Link) -> polepair.Axis:
    """A node that sends its statusword and position every 10 ms by itself."""
    axis = link.axes[0]
    axis.raw("nmt pre-operational")
    raw = axis.params.raw
    identifier = raw["tpdo 1 identifier"]
    for name, value in [
        ("identifier", identifier | 1 << 31),
        ("transmission", 255),
        ("inhibit time", 0),
        ("event time", 10),
        ("entries", 0),
        ("entry 1", 0x6041_0010),
        ("entry 2", 0x6064_0020),
        ("entries", 2),
        ("identifier", identifier & ~(1 << 31)),
    ]:
        raw[f"tpdo 1 {name}"] = value
    return axis


def test_process_data_come_by_themselves() -> None:
    with polepair.connect(NODE) as link:
        axis = sending(link)
        with link.events() as heard:
            axis.raw("nmt start")
            stamps = []
            for event in heard:
                if isinstance(event, SignalSent) and event.signal == "position":
                    assert (event.axis, event.value) == (2, 0.0)
                    stamps.append(event.time)
                if isinstance(event, ParameterSent):
                    assert (event.name, event.value) == ("statusword", event.raw)
                if len(stamps) == 100:
                    break
            assert heard.lost == 0
        assert heard.closed
        assert heard.next(1.0) is None
        gaps = [b - a for a, b in zip(stamps, stamps[1:])]
        assert gaps == pytest.approx([0.01] * 99)


def test_a_fault_is_reported_with_its_remedy() -> None:
    with polepair.connect(NODE) as link, link.axes[0].events() as heard:
        link.simulation.act("fault", 0x2310)
        event = next(event for event in heard if isinstance(event, FaultAppeared))
        assert event.code == 0x2310
        assert event.fault is not None
        assert event.fault.remedy


def test_waiting_ends_in_time_and_tells_nothing() -> None:
    with polepair.connect(NODE) as link:
        heard = link.events()
        began = link.simulation.now
        assert heard.next(0.5) is None
        assert link.simulation.now - began == pytest.approx(0.5, abs=0.01)


def test_closing_the_link_ends_a_loop_in_another_thread() -> None:
    link = polepair.connect("sim:cia402:2")
    heard: list[Happening] = []
    listening = link.events()
    thread = threading.Thread(target=lambda: heard.extend(listening))
    thread.start()
    link.axes[0]._native.arm(True)
    link.close()
    thread.join(60)
    assert not thread.is_alive()


def test_a_function_hears_everything_even_after_it_raised() -> None:
    heard: queue.Queue[Happening] = queue.Queue()
    reported: list[object] = []
    before = threading.excepthook
    threading.excepthook = lambda told: reported.append(told.exc_value)

    def hear(event: Happening) -> None:
        heard.put(event)
        if isinstance(event, ArmedChanged) and event.armed:
            raise ValueError("of the callback's own")

    try:
        with polepair.connect("sim:cia402:2") as link:
            with link.on_event(hear) as subscription:
                native = link.axes[0]._native
                native.arm(True)
                native.arm(False)
                states = []
                while len(states) < 2:
                    event = heard.get(timeout=120)
                    if isinstance(event, ArmedChanged):
                        states.append(event.armed)
                assert states == [True, False]
                assert subscription.lost == 0
            native.arm(True)
    finally:
        threading.excepthook = before
    assert [str(error) for error in reported] == ["of the callback's own"]
    assert not any(isinstance(event, ArmedChanged) for event in list(heard.queue))


def test_an_event_loop_gets_events_too() -> None:
    async def main() -> list[bool]:
        async with polepair.aio.connect("sim:cia402:2") as link:
            native = link.axes[0]._native
            called: list[Happening] = []
            subscription = link.on_event(called.append)
            told: list[bool] = []
            async with await link.events() as heard:
                asyncio.get_running_loop().call_later(0.05, native.arm, True)
                async for event in heard:
                    if isinstance(event, ArmedChanged):
                        told.append(event.armed)
                        break
                assert await heard.next(timeout=0.01) is None or heard.lost == 0
            while not any(isinstance(event, ArmedChanged) for event in called):
                await asyncio.sleep(0.01)
            await asyncio.to_thread(subscription.end)
            return told

    assert asyncio.run(main()) == [True]


def test_an_event_loop_hears_in_virtual_time() -> None:
    async def main() -> str:
        async with polepair.aio.connect(NODE) as link:
            heard = await link.axes[0].events()
            link.simulation.act("power_cycle")
            async for event in heard:
                if isinstance(event, PresenceChanged):
                    return event.presence
        return ""

    assert asyncio.run(main()) == "restarted"


def test_a_closed_link_ends_an_async_loop() -> None:
    async def main() -> None:
        link = await polepair.aio.connect("sim:tmcl")
        heard = await link.events()
        asyncio.get_running_loop().call_later(0.05, link.close)
        async for _ in heard:
            pass

    asyncio.run(asyncio.wait_for(main(), 60))


@pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX's")
def test_ctrl_c_ends_a_loop_over_events() -> None:
    program = (
        "import polepair\n"
        "with polepair.connect('sim:tmcl') as link:\n"
        "    print('listening', flush=True)\n"
        "    for event in link.events(): pass\n"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "listening\n"
    time.sleep(0.2)
    child.send_signal(signal.SIGINT)
    _, said = child.communicate(timeout=120)
    assert "KeyboardInterrupt" in said


def test_the_module_names_what_it_has() -> None:
    assert set(events.__all__) <= set(dir(events))
