"""Groups and explanations: what goes beyond one axis and one request."""

from __future__ import annotations

import asyncio
import math
import time

import can
import polepair
import pytest


def test_a_group_starts_at_one_signal() -> None:
    with polepair.connect("sim:cia402:1,2?time=virtual", trace=True) as link:
        with link.group(1, 2).armed() as both:
            motion = both.move({1: 90, 2: (-45, "deg")}, "deg")
            assert sum(" 080#" in line for line in link.trace()) == 1
            assert not motion.done()
            motion.wait()
            positions = [axis.read("position")["position"] for axis in both.axes]
            assert positions == pytest.approx([math.pi / 2, -math.pi / 4], abs=0.01)
            both.move_by([0.1, 0.1], sync=False).wait()
        assert not any(link.simulation.truth(drive=at).enabled for at in (0, 1))
        assert "axis 1" in repr(both) and "<table>" in both._repr_html_()


def test_a_group_that_cannot_start_together_moves_nothing() -> None:
    with polepair.connect("sim:tmcl:1,2?time=virtual") as link:
        with link.group().armed() as both:
            with pytest.raises(polepair.Unsupported) as raised:
                both.move([1.0, 1.0])
            assert (raised.value.code, raised.value.executed) == ("E218", False)
            assert link.simulation.truth().position == pytest.approx(0, abs=1e-3)
            both.move([1.0, 0.5], sync=False).wait()
            both.stop()
        with pytest.raises(KeyError):
            link.group(1).move({2: 1.0})


def test_an_exception_disables_a_group() -> None:
    with polepair.connect("sim:cia402:1,2?time=virtual") as link:
        with pytest.raises(ZeroDivisionError), link.group().armed() as both:
            both.move([100.0, 100.0])
            1 / 0  # noqa: B018
        link.sleep(2.0)
        truths = [link.simulation.truth(drive=at) for at in (0, 1)]
        assert not any(truth.enabled for truth in truths)


def test_a_group_of_an_event_loop() -> None:
    async def main() -> list[float]:
        async with polepair.aio.connect("sim:cia402:1,2?time=virtual") as link:
            async with link.group().armed() as both:
                await (await both.move([1.0, 0.5]))
            step_axis = link.axis(1)
            async with step_axis.armed():
                step = await step_axis.step("velocity", 60, "rpm", seconds=0.5)
                assert step.rise < 0.5
            return [(await axis.read("position"))["position"] for axis in both.axes]

    assert asyncio.run(main())[1] == pytest.approx(0.5, abs=0.01)


def test_virtual_time_is_frozen_between_calls_of_an_event_loop() -> None:
    async def main() -> None:
        async with polepair.aio.connect("sim:cia402?time=virtual") as link:
            axis = link.axis(1)
            async with axis.armed():
                await axis.move(0.5)
                began = axis._native.now
                # A thread of the library's looks every 5 ms whether it is needed.
                time.sleep(0.1)
                assert axis._native.now == began

    asyncio.run(main())


def test_a_frame_is_explained_byte_by_byte() -> None:
    bytes_of = bytes.fromhex("01 06 01 00 00 00 00 00 08")
    frame = polepair.explain("tmcl", bytes_of, to_drive=True)
    assert isinstance(frame, polepair.Explained)
    assert (frame.kind, frame.axis, frame.error, frame.bytes) == ("GAP", 1, None, bytes_of)
    assert frame.fields["checksum"] == 8
    assert [part.start for part in frame.parts] == sorted(part.start for part in frame.parts)
    assert "GAP" in str(frame) and frame._repr_html_().count("<tr>") == len(frame.parts) + 1
    assert polepair.explain("tmcl", "01 06 01 00 00 00 00 00 08").text == frame.text  # type: ignore[union-attr]
    broken = polepair.explain("tmcl", bytes_of[:8] + b"\x09")
    assert isinstance(broken, polepair.Explained) and "checksum" in (broken.error or "")


def test_can_frames_are_explained_however_they_come() -> None:
    data = bytes.fromhex("4064600000000000")
    ways = [
        polepair.explain("canopen", data, id=0x602),
        polepair.explain("canopen", "602#4064600000000000"),
        polepair.explain(
            "canopen", can.Message(arbitration_id=0x602, data=data, is_extended_id=False)
        ),
    ]
    assert len({str(way) for way in ways}) == 1
    assert isinstance(ways[0], polepair.Explained) and ways[0].axis == 2


def test_codes_have_causes_and_remedies() -> None:
    abort = polepair.explain("canopen", 0x06020000)
    assert isinstance(abort, polepair.Meaning) and "object" in (abort.text or "").lower()
    fault = polepair.explain("thruster", 1)
    assert isinstance(fault, polepair.Meaning)
    for product, found in fault.faults:
        assert product.startswith("thruster") and found.text
    with pytest.raises(polepair.Unsupported) as raised:
        polepair.explain("tmlc", 1)
    assert raised.value.code == "E203"
    with pytest.raises(polepair.Unsupported) as raised:
        polepair.explain("tmcl", "no frame at all")
    assert raised.value.code == "E241"
