"""A data sheet gives a device: python canopen loads the same file and finds each object in it."""

import contextlib
import subprocess
import time
from pathlib import Path

import canopen
import pytest
from canopen.objectdictionary import ODVariable, datatypes
from canopen.profiles.p402 import BaseNode402
from conftest import POLEPAIR
from polepair_test_support import wait_until
from test_canopen_nodes import network

SHEETS = Path(__file__).resolve().parent / "sheets"
NODE = 5
# Objects with live values, and those that python canopen reads otherwise from the file.
LIVE = {0x1010, 0x1011, 0x200D, 0x6041, 0x6061, 0x6064, 0x606C}
# A type that python canopen gives as bytes.
TIME_OF_DAY = 0x0C
# The identifier of a PDO to which the sheet forgot to add the node-ID.
FORGOTTEN = (0x1801, 1)
ABORTS = {
    "no object": 0x06020000,
    "no sub-index": 0x06090011,
    "read only": 0x06010002,
    "write only": 0x06010001,
    "length": 0x06070010,
    "too high": 0x06090031,
    "too low": 0x06090032,
    "value": 0x06090030,
}


@contextlib.contextmanager
def device(sheet, tmp_path, make=canopen.RemoteNode, wire="udp"):
    words = [f"canopen:{NODE}", "--eds", str(SHEETS / sheet)]
    with network(wire, words, tmp_path) as master:
        node = make(NODE, str(SHEETS / sheet))
        master.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = 10
        yield node


@pytest.fixture
def motor(tmp_path):
    with device("motor.eds", tmp_path) as node:
        yield node


@pytest.fixture
def inputs(tmp_path):
    with device("inputs.eds", tmp_path) as node:
        yield node


def entries(node):
    for thing in node.object_dictionary.values():
        if thing.index < 0x1000:
            continue  # a type that PDOs may map as a gap
        yield from [thing] if isinstance(thing, ODVariable) else thing.values()


def refused(why, node, index, sub, data=None):
    with pytest.raises(canopen.SdoAbortedError) as aborted:
        if data is None:
            node.sdo.upload(index, sub)
        else:
            node.sdo.download(index, sub, data)
        raise AssertionError(f"{index:04X}h:{sub} was not refused")
    assert aborted.value.code == ABORTS[why], (hex(index), sub, str(aborted.value))


def read(node, entry):
    data = node.sdo.upload(entry.index, entry.subindex)
    return entry.decode_raw(data)


@pytest.mark.parametrize("wire", ["udp", "slcan"])
@pytest.mark.parametrize("sheet", ["motor.eds", "inputs.eds"])
def test_every_object_is_there_with_its_default(sheet, wire, tmp_path):
    with device(sheet, tmp_path, wire=wire) as node:
        seen = 0
        for entry in entries(node):
            if entry.index == 0x1003 and entry.subindex:
                continue  # no error yet: refused as having no data
            if not entry.readable:
                refused("write only", node, entry.index, entry.subindex)
                continue
            value, seen = read(node, entry), seen + 1
            if (entry.index, entry.subindex) == FORGOTTEN:
                assert value == entry.default + NODE
            elif entry.default is not None and entry.index not in LIVE:
                # It does not take the bits of a negative number for one.
                default, bits = entry.default, len(entry)
                if entry.data_type in datatypes.SIGNED_TYPES and default >> (bits - 1) == 1:
                    default -= 1 << bits
                assert value == default, (hex(entry.index), entry.subindex, entry.name)
        assert seen > 20


def other(entry, value):
    """A value of the type that is not the one that is there, within the limits."""
    if entry.data_type in datatypes.INTEGER_TYPES:
        least = entry.min if entry.min is not None else 0
        return least if value != least else least + 1
    if entry.data_type in datatypes.FLOAT_TYPES:
        return value + 0.5
    if entry.data_type == datatypes.BOOLEAN:
        return not value
    if entry.data_type == TIME_OF_DAY:
        return b"\1" + value[1:]
    return (value or "") + "x" if isinstance(value, str) else bytes(value or b"") + b"x"


def test_every_object_keeps_what_it_takes_and_refuses_what_it_does_not(motor):
    written = 0
    for entry in entries(motor):
        index, sub = entry.index, entry.subindex
        if (index, sub) == (0x2020, 0):
            continue  # which python canopen takes for writable
        if not entry.writable:
            refused("read only", motor, index, sub, bytes(len(entry) // 8 or 1))
            continue
        if entry.data_type in datatypes.INTEGER_TYPES and len(entry) in (8, 16, 32):
            refused("length", motor, index, sub, bytes(3))
        if not 0x2000 <= index < 0x6000 or not entry.readable:
            continue
        value = other(entry, read(motor, entry))
        motor.sdo.download(index, sub, entry.encode_raw(value))
        assert read(motor, entry) == value, (hex(index), sub)
        written += 1
    assert written > 15


def test_aborts_are_the_standards(motor):
    refused("no object", motor, 0x2FFF, 0)
    refused("no object", motor, 0x6042, 0, b"\0\0")
    refused("no sub-index", motor, 0x2020, 6)
    refused("no sub-index", motor, 0x2001, 1)
    refused("too high", motor, 0x2001, 0, b"\x0b")
    refused("too low", motor, 0x2001, 0, b"\xf5")
    refused("value", motor, 0x6060, 0, b"\x04")
    motor.sdo.download(0x200E, 0, b"\1\2\3\4")
    motor.sdo.download(0x2010, 0, b"\xff\xff")


def pattern(size):
    return bytes((7 * n + n // 256) & 0xFF for n in range(size))


@pytest.mark.parametrize("size", [0, 1, 4, 5, 889, 20_000])
def test_a_domain_keeps_what_is_written(motor, size):
    motor.sdo.download(0x200C, 0, pattern(size), force_segment=True)
    assert motor.sdo.upload(0x200C, 0) == pattern(size)
    if size:
        with motor.sdo[0x200C].open("wb", size=size, block_transfer=True) as file:
            file.write(pattern(size)[::-1])
        assert motor.sdo.upload(0x200C, 0) == pattern(size)[::-1]


def test_the_mapping_of_the_sheet_is_live(motor):
    heard = {1: [], 2: []}
    for pdo in (*motor.tpdo.values(), *motor.rpdo.values()):
        pdo.read()
    assert motor.tpdo[2].cob_id == 0x280 + NODE, "the sheet forgot the node-ID"
    for n in heard:
        motor.tpdo[n].add_callback(lambda pdo, n=n: heard[n].append([v.raw for v in pdo]))
    motor.nmt.state = "OPERATIONAL"
    wait_until("TPDO 1 has the statusword 0250h", lambda: heard[1], lambda rows: rows[:1] == [[0x0250]])
    motor.rpdo[1][0x6040].raw = 6
    motor.rpdo[1].transmit()
    wait_until("TPDO 1 has the statusword 0231h", lambda: heard[1], lambda rows: rows[-1] == [0x0231])
    motor.sdo[0x2004].raw = 77
    motor.network.sync.transmit()
    wait_until("TPDO 2 follows SYNC", lambda: heard[2], lambda rows: rows == [[0, 77]])
    # An object that is mapped by default can be mapped again, though its entry denies it.
    motor.nmt.state = "PRE-OPERATIONAL"
    motor.tpdo[2].save()


def test_a_plain_node_keeps_and_tells(inputs):
    heard = []
    for pdo in (inputs.tpdo[1], inputs.rpdo[1]):
        pdo.read()
    inputs.tpdo[1].add_callback(lambda pdo: heard.append([value.raw for value in pdo]))
    inputs.nmt.state = "OPERATIONAL"
    inputs.rpdo[1][0].raw, inputs.rpdo[1][1].raw = 0x5A, 0xA5
    inputs.rpdo[1].transmit()
    wait_until("RPDO 1 sets 6200h:2", lambda: inputs.sdo[0x6200][2].raw, lambda value: value == 0xA5)
    inputs.network.sync.transmit()
    wait_until("TPDO 1 follows SYNC", lambda: heard, lambda rows: rows == [[0x5A, 0x81]])
    refused("no object", inputs, 0x6040, 0)
    refused("no object", inputs, 0x1008, 0)


def test_a_sheets_drive_is_driven_by_its_own_file(tmp_path):
    """Ramps and speeds that the sheet leaves at 0 are the generic drive's; a turn is its 65536."""
    with device("motor.eds", tmp_path, make=BaseNode402) as drive:
        drive.setup_402_state_machine(read_pdos=False)
        drive.op_mode = "PROFILED POSITION"
        drive.state = "OPERATION ENABLED"
        drive.sdo[0x607A].raw = 3 * 65_536
        drive.controlword = 0x0F
        drive.controlword = 0x1F
        wait_until(
            "the position is 3 turns", lambda: drive.sdo[0x6064].raw, lambda now: abs(now - 3 * 65_536) < 200
        )
        drive.op_mode = "PROFILED VELOCITY"
        drive.controlword = 0x0F
        drive.sdo[0x60FF].raw = 5 * 65_536
        wait_until(
            "the speed is 5 turns/s", lambda: drive.sdo[0x606C].raw, lambda now: abs(now - 5 * 65_536) < 30_000
        )


def test_settings_are_stored_and_come_from_the_file_again(motor):
    motor.sdo[0x2001].raw, motor.sdo[0x6083].raw = 7, 12_345
    motor.sdo[0x1010][1].raw = 0x65766173
    time.sleep(0.2)  # flash is written
    motor.sdo[0x2001].raw = 3
    wait_until("the stored settings return", lambda: reset(motor), lambda now: now == (7, 12_345))
    motor.sdo[0x1011][1].raw = 0x64616F6C
    wait_until("the settings of the file return", lambda: reset(motor), lambda now: now == (-5, 0))


def reset(node):
    """Some settings after "reset node"."""
    beats = []
    node.nmt.add_heartbeat_callback(beats.append)
    node.nmt.send_command(0x81)
    wait_until("the boot-up message", lambda: beats, lambda codes: 0 in codes)
    return node.sdo[0x2001].raw, node.sdo[0x6083].raw


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "no object in it"),
        ("[1000]\nParameterName=A\n", "no object in it"),
        ("PK\x03\x04", "no object in it"),
    ],
)
def test_a_wrong_file_is_refused_with_its_reason(text, why, tmp_path):
    file = tmp_path / "wrong.eds"
    file.write_text(text)
    done = subprocess.run(
        [POLEPAIR, "sim", "canopen:5", "--eds", str(file)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode and "wrong.eds" in done.stderr and why in done.stderr, done.stderr


def test_only_canopen_devices_have_sheets():
    done = subprocess.run(
        [POLEPAIR, "sim", "tmcl:1", "--eds", str(SHEETS / "motor.eds")],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 2 and "E213" in done.stderr, done.stderr


def test_a_drive_writes_its_own_sheet(tmp_path):
    """`polepair eds` of a TS: python canopen reads the drive's values by the names of the sheet."""
    sheet = tmp_path / "ts.eds"
    command = [POLEPAIR, "eds", "sim:syntron-ts-canopen", "-o", sheet]
    subprocess.run(command, check=True, timeout=60, capture_output=True)
    with network("udp", [f"syntron-ts-canopen:{NODE}"], tmp_path) as master:
        node = canopen.RemoteNode(NODE, str(sheet))
        master.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = 10
        assert node.object_dictionary.device_information.product_name == "SYNTRON TS servo drive on CANopen"
        assert node.sdo["password"].raw == 9870
        node.sdo["path 1 speed"].raw = 300
        assert node.sdo["path 1 speed"].raw == 300
        assert node.sdo["statusword"].raw & 0x004F in (0x0000, 0x0040)
        seen = 0
        for entry in entries(node):
            if entry.readable and entry.default is not None and entry.subindex == 0:
                seen += read(node, entry) is not None
        assert seen > 300
