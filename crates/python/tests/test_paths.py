"""Stored paths of a SYNTRON TS."""

from __future__ import annotations

import asyncio
from pathlib import Path

import polepair
import pytest
from polepair import PathTable, aio

DRIVE = "sim:syntron-ts?fn00=14&time=virtual"
TABLE = """
version = 1
travel = "360 deg"

[paths.1]
kind = "auto"
end = "absolute"
position = "90 deg"
speed = "300 rpm"
acceleration = "200 ms"
deceleration = "200 ms"
next = 2

[paths.2]
kind = "single"
end = "from-last-end"
position = "-30 deg"
speed = "300 rpm"
acceleration = "200 ms"
deceleration = "200 ms"
"""


def test_a_table_is_written_run_and_measured(tmp_path: Path) -> None:
    table = PathTable.parse(TABLE)
    assert (table.numbers, table.unit, table.travel, table.motor_turns) == ([1, 2], "deg", 360, 1)
    assert table.check() == [] and table.chain(1) == "1 -> 2"
    assert dict(table.words(2))["end"] == "from last end"
    with polepair.connect(DRIVE) as link:
        paths = link.axes[0].paths
        assert paths.read().numbers == []
        changes = paths.write(table)
        assert (1, "position", "0 deg", "90 deg") in changes
        assert paths.read() == table and paths.write(table) == []
        with pytest.raises(polepair.Unsupported) as unarmed:
            paths.run(1)
        assert unarmed.value.code == "E219"
        with link.axes[0].armed():
            assert paths.run(1) == pytest.approx(60.0, abs=1.0)
    file = tmp_path / "paths.toml"
    file.write_text(str(table), encoding="utf-8")
    assert PathTable.load(file) == table


def test_findings_refuse_a_table_and_say_why() -> None:
    wrong = PathTable.parse(TABLE.replace("next = 2", "next = 7"))
    (finding,) = wrong.check()
    assert finding.is_error and finding.path == 1 and "path 7" in finding.text, finding
    assert repr(finding).startswith("PathFinding(path=1, is_error=True, text=")
    with polepair.connect(DRIVE) as link:
        paths = link.axes[0].paths
        with pytest.raises(polepair.PolepairError) as refused:
            paths.write(wrong)
        assert refused.value.code == "E217" and paths.read().numbers == []
        endless = PathTable.parse(TABLE.replace('kind = "single"', 'kind = "auto"\nnext = 1'))
        paths.write(endless)
        with link.axes[0].armed() as axis:
            with pytest.raises(polepair.PolepairError) as never:
                paths.run(1)
            assert never.value.code == "E245" and abs(axis.read("velocity")["velocity"]) < 0.1
            paths.start(1)
            link.sleep(0.1)
            assert abs(axis.read("velocity")["velocity"]) > 1.0
    with pytest.raises(polepair.PolepairError, match="aut"):
        PathTable.parse(TABLE.replace('"auto"', '"aut"'))
    with polepair.connect("sim:tmcl?time=virtual") as link, pytest.raises(polepair.Unsupported):
        link.axes[0].paths.read()


def test_a_run_is_previewed_on_the_motor_model() -> None:
    table = PathTable.parse(TABLE)
    trace = polepair.paths.preview(table, 1)
    assert trace["position"][-1] == pytest.approx(60.0, abs=0.2)
    assert max(trace["speed"]) > 100.0
    shifted = polepair.paths.preview(table, 2, start=90.0)
    assert shifted["position"][-1] == pytest.approx(60.0, abs=0.2)


def test_event_loops_run_paths_too() -> None:
    async def program() -> float:
        async with aio.connect(DRIVE) as link:
            axis = link.axes[0]
            await axis.paths.write(PathTable.parse(TABLE))
            async with axis.armed():
                return await axis.paths.run(1)

    assert asyncio.run(program()) == pytest.approx(60.0, abs=1.0)
