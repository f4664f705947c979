"""A move that ends somewhere else is no arrival: neither `wait` nor `reached` says so."""

from __future__ import annotations

import subprocess
from pathlib import Path

import polepair
import pytest
from polepair import PolepairError
from polepair_test_support import first_line, wait_until
from served import POLEPAIR, Server

FAR = 200.0  # turns
SPEED = (60, "rpm")

# Drive, what is set before, what happens while it moves, the code and words of its error.
EARLY = [
    ("cia402:5", {}, "0x6040:0", "E102", "another master halted it"),
    ("syntron-ts-canopen:5", {"control mode": 20}, "0x6040:0", "E102", "another master halted it"),
    ("modbus-rtu", {"control mode": 14}, "jam", "E801", "ERR_PE"),
    ("modbus-rtu", {"control mode": 14}, "limit-high=720 deg", "E106", "the target is 72000 deg"),
    ("technosoft-f514l", {}, "limit-high=720 deg", "E106", "positive limit switch"),
    ("tmcm-6110", {"stop on stall velocity": (10, "rpm")}, "jam", "E106", "it stalled at"),
]


def test_a_group_that_confirms_nothing_raises() -> None:
    """On RS-485 no drive of a group may be asked: what was sent is all that is known."""
    with polepair.connect("sim:tml:1,2?time=virtual#1,g1") as link:
        one, group = link.axes
        one.clear()
        with pytest.warns(RuntimeWarning, match="axes g1: enable: nothing on this wire"):
            with group.armed():
                for verb, words in (("clear", ()), ("spin", ((60, "rpm"),))):
                    with pytest.raises(PolepairError) as unconfirmed:
                        getattr(group, verb)(*words)
                    assert unconfirmed.value.code == "E901"
                    assert "axes g1" in str(unconfirmed.value)
                wait_until(
                    "axis 1 turns", lambda: one.read("velocity")["velocity"], lambda speed: speed > 6
                )


@pytest.mark.parametrize(("drive", "before", "event", "code", "words"), EARLY)
def test_a_move_that_ends_early_raises(
    drive: str, before: dict[str, object], event: str, code: str, words: str
) -> None:
    with polepair.connect(f"sim:{drive}?time=virtual") as link:
        axis = link.axes[0]
        for name, value in before.items():
            axis.params[name] = value  # type: ignore[assignment]
        with axis.armed():
            motion = axis.move(FAR, "turn", velocity=SPEED)
            with pytest.raises(PolepairError) as unfinished:
                motion.wait(1.5)
            assert unfinished.value.code == "E101"
            if event == "0x6040:0":
                # Halt, bit 8, which this program's own verbs never set.
                axis.params.raw[event] = 0x010F
            else:
                link.simulation.act(event)
            with pytest.raises(PolepairError, match=words) as ended:
                motion.wait(300)
            assert ended.value.code == code
            assert link.simulation.truth().position < FAR * 6


# Drive, its wire, what happens while it moves (a command after the address), the code and words of its error.
BEHIND_A_SERVER = [
    ("cia402:5", "--socketcand", ["send", "write 0x6040:0 u16 0x010F", "--arm"], "E102", "another master halted it"),
    ("technosoft-f514l:1", "--tcp", ["act", "limit-high=720 deg"], "E106", "positive limit switch"),
    ("tmcm-1140:1", "--socketcand", ["send", "MST 0", "--arm"], "E102", "another master set mode 2"),
    ("tmcm-1140:1", "--socketcand", ["act", "limit-high=720 deg"], "E106", "end switch"),
]


@pytest.mark.parametrize(("drive", "wire", "event", "code", "words"), BEHIND_A_SERVER)
def test_a_server_raises_the_same(
    drive: str, wire: str, event: list[str], code: str, words: str, tmp_path: Path
) -> None:
    command = [str(POLEPAIR), "sim", drive, wire, "127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as simulation:
        try:
            url = first_line("the ready line of the simulation", simulation).split()[1]
            server = Server(tmp_path, drives=url)
            try:
                with server.join() as link, link.axes[0].armed() as axis:
                    motion = axis.move(15, "turn", velocity=(20, "rpm"))
                    wait_until(
                        "the axis is on its way",
                        lambda: axis.read("position")["position"],
                        lambda position: position > 6.3,  # rad
                    )
                    verb, *words_of_event = event
                    subprocess.run([str(POLEPAIR), verb, url, *words_of_event], check=True, timeout=120)
                    with pytest.raises(PolepairError, match=words) as ended:
                        motion.wait(120)
                    assert ended.value.code == code
            finally:
                server.kill()
        finally:
            simulation.kill()


def test_a_flag_is_no_arrival_for_a_reader(tmp_path: Path) -> None:
    command = [str(POLEPAIR), "sim", "cia402:5", "--socketcand", "127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as simulation:
        try:
            url = first_line("the ready line of the simulation", simulation).split()[1]
            server = Server(tmp_path, drives=url)
            try:
                with server.join() as viewer, server.join() as link, link.axes[0].armed() as axis:
                    motion = axis.move(15, "turn", velocity=(60, "rpm"))
                    # A halt of another master: the bit of an arrival then means standstill.
                    halt = [str(POLEPAIR), "send", url, "write 0x6040:0 u16 0x010F", "--arm"]
                    subprocess.run(halt, check=True, timeout=120)
                    with pytest.raises(PolepairError, match="halted"):
                        motion.wait(120)
                    assert viewer.axes[0].read("reached")["reached"] == 1.0
                    assert not viewer.axes[0].reached(0.5)
                    axis.move(1, "turn", velocity=(60, "rpm")).wait(120)
                    assert viewer.axes[0].reached(60)
            finally:
                server.kill()
        finally:
            simulation.kill()
