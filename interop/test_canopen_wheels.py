"""The profile of a drive whose two motors are sub-indices of one node, against python canopen's LocalNode."""

import struct
import threading
import time
from pathlib import Path

import canopen
import pytest
from canopen.objectdictionary import ObjectDictionary, ODArray, ODVariable, datatypes
from conftest import polepair
from modbus_motors import COUNTS, Motor

FILE = str(Path(__file__).resolve().parents[1] / "docs" / "examples" / "zlac8015d-canopen.toml")
GROUP, PORT, NODE = "239.74.163.2", 43185, 1
URL = f"canopen+udp://{GROUP}:{PORT}?profile=zlac8015d-canopen&timeout=3000"
SINGLE = {
    0x1000: "UNSIGNED32", 0x1017: "UNSIGNED16", 0x2000: "UNSIGNED16", 0x200F: "UNSIGNED16", 0x603F: "UNSIGNED32", 0x6040: "UNSIGNED16",
    0x6041: "UNSIGNED32", 0x6060: "INTEGER8", 0x6061: "INTEGER8",
}  # fmt: skip
EACH = {
    0x6064: "INTEGER32", 0x606C: "INTEGER32", 0x607A: "INTEGER32", 0x6081: "UNSIGNED32", 0x6083: "UNSIGNED32",
    0x6084: "UNSIGNED32", 0x60FF: "INTEGER32",
}  # fmt: skip


def variable(index, sub, kind):
    entry = ODVariable(f"{index:X}:{sub}", index, sub)
    entry.data_type, entry.access_type, entry.default = getattr(datatypes, kind), "rw", 0
    return entry


def dictionary():
    made = ObjectDictionary()
    for index, kind in SINGLE.items():
        made.add_object(variable(index, 0, kind))
    for index, kind in EACH.items():
        array = ODArray(f"{index:X}", index)
        for sub, its in [(0, "UNSIGNED8"), (1, kind), (2, kind)]:
            array.add_member(variable(index, sub, its))
        made.add_object(array)
    return made


class Wheels:
    """Two motors with one control word and one mode, as the maker's manual has them."""

    def __init__(self, node):
        self.node, self.motors, self.state, self.lock = node, [Motor(), Motor()], 0x40, threading.Lock()
        self.faults = [0, 0]
        self.show(0x6061, 0, 0)
        node.add_read_callback(self.read)
        node.add_write_callback(self.write)

    def show(self, index, sub, value):
        kind = {"UNSIGNED8": "B", "INTEGER8": "b", "UNSIGNED16": "<H", "UNSIGNED32": "<I", "INTEGER32": "<i"}
        form = kind[SINGLE.get(index) or EACH[index]]
        self.node.data_store.setdefault(index, {})[sub] = struct.pack(form, value)

    def number(self, index, sub):
        kept = self.node.data_store.get(index, {}).get(sub, b"")
        return int.from_bytes(kept, "little", signed=index in (0x6060, 0x607A, 0x60FF))

    def read(self, index, subindex, od):
        with self.lock:
            for n, motor in enumerate(self.motors, 1):
                motor.advance()
                self.show(0x6064, n, round(motor.position * COUNTS))
                self.show(0x606C, n, round(10 * motor.speed))
            states = [0x08 if fault else self.state for fault in self.faults]
            self.show(0x6041, 0, states[0] | states[1] << 16)
            self.show(0x603F, 0, self.faults[0] | self.faults[1] << 16)
            self.show(0x6061, 0, self.number(0x6060, 0))

    def write(self, index, subindex, od, data):
        with self.lock:
            # The node keeps it only afterwards.
            self.node.data_store.setdefault(index, {})[subindex] = bytes(data)
            mode = self.number(0x6060, 0)
            if index == 0x6040:
                self.control(int.from_bytes(data, "little"), mode)
            elif index == 0x60FF and mode == 3 and self.state == 0x27:
                self.motors[subindex - 1].run(self.number(0x60FF, subindex))

    def control(self, word, mode):
        if word & 0x80:
            self.faults = [0, 0]
        states = {0: 0x40, 2: 0x07, 6: 0x21, 7: 0x23, 15: 0x27}
        self.state = states.get(word & 15, self.state)
        for n, motor in enumerate(self.motors, 1):
            if self.state != 0x27 or any(self.faults):
                motor.run(0)
            elif word & 16 and mode == 1:
                motor.go(self.number(0x607A, n) / COUNTS, self.number(0x6081, n) or 120)


@pytest.fixture
def wheels():
    network = canopen.Network()
    network.connect(interface="udp_multicast", channel=GROUP, port=PORT, receive_own_messages=False)
    node = network.create_node(NODE, dictionary())
    node.nmt.state = "PRE-OPERATIONAL"
    yield Wheels(node)
    network.disconnect()


def run(verb, axes, *words, check=True):
    return polepair(verb, "--profile", FILE, f"{URL}#{axes}", *words, check=check)


def speeds(wheels):
    return [motor.speed for motor in wheels.motors]


def test_each_motor_turns_alone_and_both_together(wheels):
    both = run("spin", "1,1.2", "--for", "2s", "60rpm").stdout
    assert both.count("velocity reached = 60 rpm") == 2, both
    assert speeds(wheels) == [0, 0]
    run("spin", "1.2", "--detach", "-60rpm")
    assert speeds(wheels) == [0, -60]
    run("spin", "1", "--detach", "30rpm")
    assert speeds(wheels) == [30, -60]
    shown = run("get", "1,1.2", "actual speed").stdout
    assert "30 rpm" in shown and "-60 rpm" in shown, shown
    run("stop", "1.2")
    assert speeds(wheels) == [30, 0]
    run("stop", "1")
    assert speeds(wheels) == [0, 0]


def test_each_motor_has_its_own_target(wheels):
    run("move", "1", "1turn", "--vel", "120rpm")
    run("move", "1.2", "-0.5turn", "--vel", "120rpm")
    assert all(abs(m.position - at) < 0.001 for m, at in zip(wheels.motors, (1, -0.5)))
    # A start is for both, so the other one has to stand.
    run("move", "1", "2000turn", "--vel", "60rpm", "--detach")
    refused = run("move", "1.2", "0turn", "--vel", "240rpm", check=False)
    assert refused.returncode != 0 and "wait until the other one stands" in refused.stderr, refused.stderr
    run("stop", "1")
    assert abs(wheels.motors[1].position + 0.5) < 0.001
    # After a motion in the speed mode an old target of the other one moves nothing.
    run("spin", "1.2", "--for", "1s", "60rpm")
    before = wheels.motors[1].position
    run("move", "1", "3.5turn", "--vel", "1000rpm")
    assert abs(wheels.motors[1].position - before) < 0.001
    assert abs(wheels.motors[0].position - 3.5) < 0.001


def test_a_stop_in_the_position_mode_leaves_the_other_motor(wheels):
    run("move", "1", "2000turn", "--vel", "120rpm", "--detach")
    run("stop", "1.2")
    assert wheels.motors[0].wanted == 120
    # A stop of the node is one of both.
    stopped = run("stop", "1").stderr
    assert "axis 1 is stopped" in stopped and "axis 1.2 is stopped" in stopped, stopped
    assert speeds(wheels) == [0, 0] and wheels.motors[0].position < 1900


def test_a_fault_is_that_of_its_motor(wheels):
    wheels.faults = [0, 4]
    refused = run("spin", "1.2", "60rpm", "--for", "1s", check=False)
    assert refused.returncode != 0 and "Overcurrent" in refused.stderr, refused.stderr
    assert "Overcurrent" in run("info", "1.2").stdout
    assert "Overcurrent" not in run("info", "1").stdout
    run("clear", "1.2")
    assert wheels.faults == [0, 0]
    time.sleep(0.1)
    assert "velocity reached" in run("spin", "1.2", "60rpm", "--for", "1s").stdout
