"""python canopen's own CiA 402 node drives our simulated drives in every mode it knows."""

import time

import pytest
from canopen.profiles.p402 import BaseNode402
from canopen_objects import dictionary
from polepair_test_support import wait_until
from test_canopen_nodes import NODE, network

# Bit 10 of the statusword (CiA 402-2).
TARGET_REACHED = 0x400


class PatientNode(BaseNode402):
    """The client as it is, but for its patience with a busy machine."""

    TIMEOUT_RESET_FAULT = TIMEOUT_SWITCH_OP_MODE = 30
    TIMEOUT_SWITCH_STATE_FINAL = TIMEOUT_SWITCH_STATE_SINGLE = 30
    TIMEOUT_CHECK_TPDO = TIMEOUT_HOMING_DEFAULT = 30


# Word of the drive, then units of its objects in a turn of the motor, a turn a second, and a ramp.
GENERIC = ("cia402:2", 10_000, 10_000, 500_000)
TS = ("syntron-ts-canopen:2", 10_000, 600, 200)


@pytest.fixture(
    params=[("udp", GENERIC), ("slcan", GENERIC), ("udp", TS), ("slcan", TS)],
    ids=["generic-udp", "generic-slcan", "ts-udp", "ts-slcan"],
)
def drive(request, tmp_path):
    wire, (words, turn, speed, ramp) = request.param
    with network(wire, words, tmp_path) as master:
        node = PatientNode(NODE, dictionary())
        master.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = 10
        if words.startswith("syntron"):
            node.sdo[0x2000].raw = 20
        node.nmt.state = "PRE-OPERATIONAL"
        node.setup_402_state_machine()
        node.nmt.state = "OPERATIONAL"
        for index in (0x6083, 0x6084, 0x609A):
            node.sdo[index].raw = ramp
        node.turn, node.turn_per_s = turn, speed
        yield node


def test_states_up_and_down(drive):
    assert drive.state == "SWITCH ON DISABLED"
    drive.state = "OPERATION ENABLED"
    for state in ["READY TO SWITCH ON", "OPERATION ENABLED", "SWITCHED ON", "SWITCH ON DISABLED"]:
        drive.state = state
        assert drive.state == state


def test_profile_position(drive):
    drive.op_mode = "PROFILED POSITION"
    drive.state = "OPERATION ENABLED"
    drive.sdo[0x6081].raw = 10 * drive.turn_per_s
    for target, relative, goal in [(5, 0, 5), (-3, 0, -3), (4, 0x40, 1)]:
        drive.sdo[0x607A].raw = target * drive.turn
        drive.controlword = 0x0F
        drive.controlword = 0x1F | relative
        wait_until("the set-point is acknowledged", lambda: drive.sdo[0x6041].raw, lambda word: word & 0x1000)
        drive.controlword = 0x0F | relative
        wait_until(
            f"the target {goal * drive.turn} is reached",
            lambda: (drive.sdo[0x6041].raw, drive.sdo[0x6064].raw),
            lambda seen: seen[0] & TARGET_REACHED and abs(seen[1] - goal * drive.turn) <= 20,
        )


def test_profile_velocity(drive):
    drive.op_mode = "PROFILED VELOCITY"
    drive.state = "OPERATION ENABLED"
    for turns in [10, -5, 0]:
        drive.sdo[0x60FF].raw = turns * drive.turn_per_s
        wait_until("the target is reached", lambda: drive.sdo[0x6041].raw, lambda word: word & TARGET_REACHED)
        tolerance = 0.15 * max(abs(turns), 1)
        wait_until(f"the speed is {turns} turns/s", lambda: measured(drive), lambda now: abs(now - turns) < tolerance)


def measured(node):
    """Turns a second by two looks at the position; a busy machine may spoil one."""
    before, begun = node.sdo[0x6064].raw, time.monotonic()
    time.sleep(0.3)
    after, ended = node.sdo[0x6064].raw, time.monotonic()
    return (after - before) / node.turn / (ended - begun)


def test_profile_torque(drive):
    drive.op_mode = "PROFILED TORQUE"
    drive.sdo[0x6087].raw = 1000
    drive.state = "OPERATION ENABLED"
    drive.sdo[0x6071].raw = 100
    start = drive.sdo[0x6064].raw
    wait_until("the motor turns twice", lambda: drive.sdo[0x6064].raw, lambda now: now > start + 2 * drive.turn)
    assert 50 <= drive.sdo[0x6077].raw <= 150 or drive.sdo[0x606C].raw > 0
    drive.sdo[0x6071].raw = 0


def test_homing(drive):
    drive.sdo[0x6099][1].raw = 5 * drive.turn_per_s
    drive.sdo[0x6099][2].raw = drive.turn_per_s
    drive.sdo[0x6098].raw = 20
    # The client may take a statusword from before the start for an interruption, and says so; homing
    # goes on whatever it says.
    drive.homing(timeout=120)
    wait_until("homing has ended", drive.is_homed)
    # The home switch closes half a turn behind where the drive got power: that is zero now.
    drive.op_mode = "PROFILED POSITION"
    drive.state = "OPERATION ENABLED"
    wait_until("the motor is near zero", lambda: drive.sdo[0x6064].raw, lambda now: abs(now) < drive.turn)


def test_the_torque_recipe_as_printed_turns_nothing(drive):
    drive.op_mode = "PROFILED VELOCITY"
    drive.sdo[0x6071].raw = 100
    drive.state = "OPERATION ENABLED"
    time.sleep(0.5)
    assert abs(drive.sdo[0x6064].raw) <= 20
