"""Run in the guest by test_socketcan.py: CANopen drives and thrusters of ours on the kernel's CAN."""

import json
import logging
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent.parent))

import canopen
from canopen.profiles.p402 import BaseNode402
from canopen_objects import dictionary
from checks import Candump, check, run, run_all
from polepair_test_support import MAX_WAIT, wait_until

logging.disable()  # that objects are not mapped, at every look
POLEPAIR = sys.argv[1]
BUS, NODE = "vcan0", 2


class PatientNode(BaseNode402):
    """The client as it is, but for its patience with a slow machine."""

    TIMEOUT_SWITCH_OP_MODE = TIMEOUT_CHECK_TPDO = MAX_WAIT
    TIMEOUT_SWITCH_STATE_FINAL = TIMEOUT_SWITCH_STATE_SINGLE = MAX_WAIT


@contextmanager
def simulated(words):
    """A drive on the bus; gives what our own host calls it."""
    process = subprocess.Popen(
        [POLEPAIR, "sim", words, "--can", BUS], stdout=subprocess.PIPE, text=True
    )
    try:
        yield process.stdout.readline().split()[1]
    finally:
        process.terminate()
        process.wait(MAX_WAIT)


@contextmanager
def driven(words):
    """python canopen over socketcan, and a drive that it can command."""
    with simulated(words):
        master = canopen.Network()
        master.connect(interface="socketcan", channel=BUS)
        node = PatientNode(NODE, dictionary())
        master.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = MAX_WAIT
        try:
            yield node
        finally:
            master.disconnect()


def send(*lines):
    """Frames as the manual prints them: `602 2B 40 60 00 06 00 00 00`."""
    for line in lines:
        identifier, *data = line.split()
        run("cansend", BUS, f"{identifier}#{''.join(data)}")


def answer(log, line, identifier):
    """The data of the first frame with that identifier after a frame was sent."""
    log.heard(0.3)
    log.text = b""
    send(line)
    wait_until(
        f"a reply {identifier} to {line}",
        lambda: log.heard(0.3),
        lambda frames: any(f" {identifier}#" in frame for frame in frames),
    )
    frames = [frame.split(f" {identifier}#") for frame in log.heard(0.1)]
    return bytes.fromhex(next(frame[1] for frame in frames if len(frame) == 2))


def read(log, index, sub=0):
    """An object, signed, by a plain SDO."""
    request = f"602 40 {index & 0xFF:02X} {index >> 8:02X} {sub:02X} 00 00 00 00"
    data = answer(log, request, "582")
    size = {0x43: 4, 0x4B: 2, 0x4F: 1}[data[0]]
    return int.from_bytes(data[4 : 4 + size], "little", signed=True)


@check
def python_canopen_manages_a_node():
    with driven("cia402:2") as node:
        beats = []
        node.nmt.add_heartbeat_callback(beats.append)
        node.sdo[0x1017].raw = 100
        for state, code in [("OPERATIONAL", 5), ("STOPPED", 4), ("PRE-OPERATIONAL", 127)]:
            node.nmt.state = state
            wait_until(f"a heartbeat with {state}", lambda: beats, lambda codes: codes[-1:] == [code])
        assert node.sdo[0x1008].raw == "Polepair CiA 402 drive", "in segments"
        node.sdo[0x2F01][1].raw = 889
        with node.sdo[0x2F01][2].open("rb", block_transfer=True) as file:
            assert len(file.read()) == 889, "in blocks"
        try:
            node.sdo.download(0x6041, 0, b"\0\0")
        except canopen.SdoAbortedError as aborted:
            assert aborted.code == 0x06010002, aborted
        emergencies = []
        node.emcy.add_callback(emergencies.append)
        node.sdo[0x1016][1].raw = 127 << 16 | 100
        node.nmt.state = "OPERATIONAL"
        node.network.send_message(0x77F, b"\x05")
        wait_until(
            "the emergency 8130h", lambda: [one.code for one in emergencies], lambda codes: codes == [0x8130]
        )
        node.nmt.send_command(0x81)
        wait_until("the boot-up message", lambda: beats, lambda codes: 0 in codes)


@check
def python_canopen_has_pdos_go_with_sync():
    with driven("cia402:2") as node:
        node.nmt.state = "PRE-OPERATIONAL"
        node.pdo.read()
        out, back = node.rpdo[1], node.tpdo[2]
        for pdo, objects in [(out, [0x60FF]), (back, [0x6041, 0x60FF])]:
            pdo.clear()
            for index in objects:
                pdo.add_variable(index)
            pdo.trans_type, pdo.enabled = 1, True
        node.pdo.save()
        node.nmt.state = "OPERATIONAL"
        heard = []
        back.add_callback(lambda pdo: heard.append(pdo[0x60FF].raw))
        out[0x60FF].raw = 4321
        out.transmit()
        for n in range(1, 4):
            node.network.sync.transmit()
            wait_until(f"TPDO 2 follows SYNC {n}", lambda: heard, lambda rows: len(rows) == n)
        assert heard[-1] == 4321, heard


@check
def python_canopen_moves_and_turns_a_drive():
    with driven("cia402:2") as node:
        node.setup_402_state_machine(read_pdos=False)
        node.op_mode = "PROFILED POSITION"
        node.state = "OPERATION ENABLED"
        node.sdo[0x607A].raw = 30_000
        node.controlword = 0x0F
        node.controlword = 0x1F
        wait_until("the position is 30000", lambda: node.sdo[0x6064].raw, lambda now: abs(now - 30_000) < 20)
        node.op_mode = "PROFILED VELOCITY"
        node.controlword = 0x0F
        node.sdo[0x60FF].raw = 50_000
        wait_until("the speed is 50000", lambda: node.sdo[0x606C].raw, lambda now: abs(now - 50_000) < 5000)


# Manual, 3.5.4: PDOs are mapped without being switched off, some with seven bytes.
CONTROL = ["602 2F 00 16 00 00 00 00", "602 23 00 16 01 10 00 40 60", "602 2F 00 16 00 01 00 00 00"]
RAMPS = [
    "602 2F 01 16 00 00 00 00",
    "602 23 01 16 01 20 00 83 60",
    "602 23 01 16 02 20 00 84 60",
    "602 2F 01 16 00 02 00 00 00",
]
UP = [f"602 2B 40 60 00 {word} 00 00 00" for word in ("06", "07", "0F")]
CANOPEN_MODE, START = "602 2B 00 20 00 14 00 00 00", "000 01 02"


def mapped(number, low, high="60"):
    n = f"{number - 1:02X}"
    return [
        f"602 2F {n} 16 00 00 00 00",
        f"602 23 {n} 16 01 20 00 {low} {high}",
        f"602 2F {n} 16 00 01 00 00 00",
    ]


@contextmanager
def commanded():
    """The TS set to obey CANopen, and candump, which sees what it says."""
    with simulated("syntron-ts-canopen:2"), Candump(BUS) as log:
        send(CANOPEN_MODE, START)
        assert read(log, 0x6041) == 0x50
        yield log


@check
def cansend_turns_the_ts_by_the_printed_speed_sequence():
    with commanded() as log:
        send(*CONTROL, *RAMPS, *mapped(3, "FF"), "602 2F 60 60 00 03 00 00 00")
        send("302 E8 03 00 00 E8 03 00 00", "402 64 00 00 00", *UP)
        assert (read(log, 0x6083), read(log, 0x60FF)) == (1000, 100)
        wait_until("the speed is 10", lambda: read(log, 0x606C), lambda now: abs(now - 10) <= 1)
        assert read(log, 0x6041) & 0x7F == 0x37


@check
def cansend_moves_the_ts_by_the_printed_position_sequence():
    with commanded() as log:
        send(*CONTROL, *RAMPS, *mapped(3, "7A"), *mapped(4, "81"), "602 2F 60 60 00 01 00 00 00")
        send("402 60 EA 00 00", "502 B8 0B 00 00", "302 E8 03 00 00 E8 03 00 00")
        send("602 2B 93 60 01 01 00 00 00", "602 2B 93 60 02 01 00 00 00", *UP)
        for _ in range(2):  # relative: each one adds
            before = read(log, 0x6064)
            send("202 0F 00", "202 5F 00", "202 4F 00")
            goal = before + 60_000
            wait_until(f"the position is {goal}", lambda: read(log, 0x6064), lambda now: abs(now - goal) <= 20)


@check
def cansend_turns_the_ts_by_torque_only_without_the_erratum():
    with commanded() as log:
        torque = ["602 2F 87 60 00 E8 03 00 00", "602 2F 71 60 00 64 00 00 00"]
        send("602 2F 60 60 00 03 00 00 00", *torque, *UP)
        assert read(log, 0x6071) == 100
        time.sleep(0.5)
        assert abs(read(log, 0x6064)) <= 20, "in speed mode it stands"
        send("602 2F 60 60 00 04 00 00 00")
        wait_until("the motor turns", lambda: read(log, 0x6064), lambda now: now > 10_000)


@check
def cansend_homes_the_ts_by_the_printed_sequence():
    with commanded() as log:
        send("602 2F 60 60 00 06 00 00 00", "602 2F 98 60 00 14 00 00 00")
        send("602 23 99 60 01 D0 07 00 00", "602 23 99 60 02 C8 00 00 00")
        send("602 23 9A 60 00 E8 03 00 00", *UP)
        send(*(f"602 2B 40 60 00 {word} 00 00 00" for word in ("0F", "5F", "4F")))
        wait_until("homing has ended", lambda: read(log, 0x6041), lambda word: word & 0x3400 == 0x1400)


@check
def candump_sees_the_printed_examples_answered():
    with simulated("syntron-ts-canopen:2"), Candump(BUS) as log:
        written = answer(log, "602 2B 33 20 00 C8 00 00 00", "582")
        assert written == bytes.fromhex("60332000C8000000"), "the data is repeated"
        assert answer(log, "602 40 00 30 00 00 00 00 00", "582")[:4] == bytes.fromhex("4B003000")
        assert answer(log, "000 82 02", "702") == b"\0"
        send("602 2B 17 10 00 64 00 00 00")
        wait_until(
            "a heartbeat", lambda: log.heard(0.3), lambda frames: any("702#7F" in frame for frame in frames)
        )


@check
def our_host_drives_a_node_on_vcan():
    with simulated("cia402:2") as url, Candump(BUS) as log:
        assert url == f"canopen+socketcan://{BUS}#{NODE}", url
        assert "cia402" in run(POLEPAIR, "info", url)
        run(POLEPAIR, "set", url, "profile velocity=600rpm")
        run(POLEPAIR, "move", url, "2rev", "--rel")
        told = run(POLEPAIR, "get", url, "6064h", "--raw")
        assert abs(int(told.split()[-1]) - 20_000) < 50, told
        ids = {frame.split()[1].split("#")[0] for frame in log.heard(0.5)}
        assert {"602", "582"} <= ids <= {"000", "080", "602", "582", "702", "182", "202"}, ids


@check
def cansend_runs_a_thruster():
    with simulated("thruster:11"), Candump(BUS) as log:
        assert answer(log, "30B 54 43 00 00 00 00 00 05", "28B")[4:] == b"\0\0\xee\xee", "not armed"
        for line in ["54 43 00 00 00 00 00 00", "54 43 00 00 FF FF FF FB", "56 43 00 00 00 00 01 F4"]:
            said = answer(log, f"30B {line}", "28B")
            assert said[:2] == bytes.fromhex(line)[:2] and said[6:] == bytes.fromhex(line)[6:], said
        wait_until(
            "the speed is 500",
            lambda: int.from_bytes(answer(log, "30B 51 56 00 00", "28B")[6:], "big"),
            lambda speed: abs(speed - 500) <= 2,
        )
        assert answer(log, "30B 51 50 00 00", "28B") == bytes.fromhex("51500000000001E0")


@check
def our_search_finds_what_is_on_the_bus():
    """`polepair scan INTERFACE` without a protocol. Thrusters are asked only where no CANopen node replies: for such
    a node their questions are PDOs."""
    for words, protocol, asks_thrusters in [("cia402:2", "canopen", False), ("thruster:11", "thruster", True)]:
        with simulated(words), Candump(BUS) as log:
            found = run(POLEPAIR, "scan", BUS, "--format", "jsonl").splitlines()
            number = words.split(":")[1]
            assert [json.loads(line)["url"] for line in found] == [f"{protocol}+socketcan://{BUS}#{number}"], found
            ids = {int(frame.split()[1].split("#")[0], 16) for frame in log.heard(0.5)}
            assert any(0x301 <= each <= 0x37F for each in ids) == asks_thrusters, sorted(map(hex, ids))


run_all()
