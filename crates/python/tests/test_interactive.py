"""The package at a prompt: Tab, `dir`, `repr` and `help`."""

from __future__ import annotations

import asyncio
import inspect
import json
import subprocess
import sys
from collections.abc import Iterator
from types import FunctionType, ModuleType
from typing import Any, get_args

import pytest

import polepair
from polepair import quantity

TABS = {
    'axis.params["max cu': {"max current"},
    'link.axes[0].params["max cu': {"max current"},
    "axis.signals['target p": {"target position"},
    'axis.read("position", "vel': {"velocity", "velocity p", "velocity i"},
    'axis.capture(["volt': {"voltage"},
    'axis.read_text("max cu': {"max current"},
    'axis.move(90, "d': {"deg", "degrees"},
    'axis.spin(60, "rp': {"rpm"},
    'axis.torque(1, "mN': {"mNm"},
    'axis.step("velocity", 60, "rp': {"rpm"},
    'parameters["max cu': {"current"},
}
"""Begun lines, and names that Tab offers for each."""

SHELL = """
import json, sys
from IPython.core.interactiveshell import InteractiveShell
shell = InteractiveShell.instance()
shell.run_cell('import polepair; link = polepair.connect("sim:tmcl?time=virtual")')
shell.run_cell("axis = link.axes[0]; parameters = axis.params")
lines = json.loads(sys.argv[1])
print(json.dumps([shell.complete("", line, len(line))[1] for line in lines]))
"""
"""A shell that imports the package, as IPython and notebooks do."""


@pytest.fixture
def link() -> Iterator[polepair.Link]:
    with polepair.connect("sim:tmcl?time=virtual") as link:
        yield link


def test_tab_completes_parameters_signals_and_units_in_ipython() -> None:
    command = [sys.executable, "-c", SHELL, json.dumps([*TABS, 'axis.raw("GA'])]
    shell = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    *found, other = json.loads(shell.stdout.splitlines()[-1])
    for line, names in zip(TABS, found, strict=True):
        offered = {name.strip("\"'] ") for name in names}
        assert TABS[line] <= offered, (line, names)
    assert "max current" not in other


def test_dir_lists_what_is_public() -> None:
    listed = {name for name in dir(polepair) if not name.startswith("__")}
    assert listed == {name for name in polepair.__all__ if not name.startswith("__")}
    for name in listed:
        assert getattr(polepair, name) is not None


def shown(link: polepair.Link) -> list[object]:
    axis, group = link.axes[0], link.group()
    trace = axis.capture(["position"], seconds=0.05)
    simulation = link.simulation
    with axis.armed() as armed:
        moves = [armed.move(0.1), armed.armed]
    return [
        link, axis, axis.params, axis.params.raw, axis.params.info("max current"), axis.params["max current"],
        axis.state(), axis.armed(), axis.watch("position"), axis.events(), group, group.armed(), *moves,
        link.on_event(print), simulation, simulation.truth(), trace, polepair.Codec("tmcl"),
        polepair.explain("tmcl", "01 04 00 00 00 00 00 00 05"),
    ]


async def shown_to_loops() -> list[object]:
    opening = polepair.aio.connect("sim:tmcl?time=virtual")
    async with opening as link:
        axis, group = link.axes[0], link.group()
        return [opening, link, axis, axis.params, axis.armed(), axis.watch("position"), group, group.armed()]


def test_every_object_shows_itself(link: polepair.Link) -> None:
    for thing in [*shown(link), *asyncio.run(shown_to_loops())]:
        if not inspect.ismethod(thing):
            assert " object at 0x" not in repr(thing), repr(thing)
    assert repr(link.axes[0].params.info("max current")) == "<Parameter max current (AP 6) in A: raw 0 to 250>"


def documented(owner: type | ModuleType) -> Iterator[tuple[str, Any]]:
    for name, member in inspect.getmembers(owner):
        if not name.startswith("_") and isinstance(member, FunctionType):
            yield name, member


@pytest.mark.parametrize("owner", [polepair.Axis, polepair.Group, polepair.Link, polepair.Parameters, polepair])
def test_help_of_calls_with_arguments_has_an_example(owner: type | ModuleType) -> None:
    inherited = {"get", "pop", "setdefault", "update"}
    for name, call in documented(owner):
        parameters = [each for each in inspect.signature(call).parameters if each != "self"]
        if parameters and name not in inherited:
            assert f"{name}(" in (call.__doc__ or ""), f"{owner.__name__}.{name}"


def test_the_words_of_units_and_signals_are_those_of_the_library(link: polepair.Link) -> None:
    axis = link.axes[0]
    for name in get_args(quantity.Signal):
        assert polepair._polepair.is_signal(name), name
    with pytest.raises(polepair.Unsupported) as unknown:
        axis.params["max current"] = "1 xyz"
    known = unknown.value.hint.removeprefix("units are ").split(", ")
    for verb, argument, words in [
        ("move-to", "target", get_args(quantity.PositionUnit)),
        ("velocity", "velocity", get_args(quantity.VelocityUnit)),
    ]:
        turning = set()
        for unit in known:
            try:
                axis._native.in_si(verb, argument, f"1 {unit}")
            except polepair.Unsupported:
                continue
            turning.add(unit)
        assert turning <= set(words)
        # Units of linear motion are for axes with such a mounting.
        assert set(words) - turning <= {"m", "cm", "mm", "um", "µm", "m/s", "mm/s"}
        assert set(words) <= set(known)
    assert set(get_args(quantity.TorqueUnit)) <= set(known)
