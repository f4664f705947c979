"""Objects and registers by their number: our host against python canopen's LocalNode and pymodbus."""

import csv
import io
import json
import os

import canopen
import polepair as polepair_module
import pytest
from canopen.objectdictionary import ODRecord, ODVariable, ObjectDictionary, datatypes
from conftest import polepair
from pymodbus import FramerType, ModbusDeviceIdentification
from pymodbus.server import ModbusTcpServer
from test_foreign_devices import Server

GROUP, PORT = "239.74.163.2", 46120 + os.getpid() % 1000
NODE = 5
URL = f"canopen+udp://{GROUP}:{PORT}?timeout=3000#{NODE}"

# Sub-index: type, address type, value, another value.
TYPES = {
    1: (datatypes.UNSIGNED8, "u8", 200, 3),
    2: (datatypes.INTEGER8, "i8", -5, 7),
    3: (datatypes.UNSIGNED16, "u16", 60000, 1),
    4: (datatypes.INTEGER16, "i16", -30000, 2),
    5: (datatypes.UNSIGNED32, "u32", 4000000000, 5),
    6: (datatypes.INTEGER32, "i32", -2000000000, 6),
    7: (datatypes.UNSIGNED64, "u64", 18446744073709551615, 9007199254740993),
    8: (datatypes.INTEGER64, "i64", -9223372036854775807, 8),
    9: (datatypes.REAL32, "f32", 1.5, -0.1),
    10: (datatypes.REAL64, "f64", -2.718281828, 1e-300),
}


def variable(index, sub, kind, value):
    entry = ODVariable(f"o{index:04X}_{sub}", index, sub)
    entry.data_type, entry.access_type = kind, "rw"
    entry.value = entry.default = value
    return entry


def dictionary():
    made = ObjectDictionary()
    made.add_object(variable(0x1000, 0, datatypes.UNSIGNED32, 0))
    made.add_object(variable(0x1001, 0, datatypes.UNSIGNED8, 0))
    made.add_object(variable(0x1017, 0, datatypes.UNSIGNED16, 0))
    made.add_object(variable(0x1008, 0, datatypes.VISIBLE_STRING, "Foreign node 0.1"))
    made.add_object(variable(0x2040, 0, datatypes.VISIBLE_STRING, "a text of its own"))
    made.add_object(variable(0x1F50, 0, datatypes.DOMAIN, bytes(range(256)) * 4))
    record = ODRecord("types", 0x2030)
    for sub, (kind, _, value, _) in TYPES.items():
        record.add_member(variable(0x2030, sub, kind, value))
    made.add_object(record)
    return made


@pytest.fixture
def node():
    network = canopen.Network()
    network.connect(interface="udp_multicast", channel=GROUP, port=PORT, receive_own_messages=False)
    local = network.create_node(NODE, dictionary())
    local.nmt.state = "PRE-OPERATIONAL"
    yield local
    network.disconnect()


def test_every_type_is_read_and_written(node):
    addresses = [f"0x2030:{sub}:{word}" for sub, (_, word, _, _) in TYPES.items()]
    lines = polepair("get", URL, *addresses).stdout.splitlines()
    shown = [line.split(" = ")[1] for line in lines]
    for text, (_, word, value, _) in zip(shown, TYPES.values(), strict=True):
        assert text == str(value), word
    wanted = [f"{at}={TYPES[sub][3]}" for sub, at in enumerate(addresses, 1)]
    polepair("set", URL, *wanted, "--arm")
    for sub, (_, word, _, value) in TYPES.items():
        assert node.sdo[0x2030][sub].raw == pytest.approx(value, rel=1e-7, abs=0), word


def test_without_a_type_a_number_is_as_long_as_the_answer(node):
    shown = polepair("get", URL, "2030h:3", "2030h:7", "0x1000", "--raw").stdout
    assert "60000" in shown and "18446744073709551615" in shown, shown
    refused = polepair("set", URL, "2030h:3=1", "--arm", check=False)
    assert refused.returncode == 2 and "the type of" in refused.stderr, refused.stderr
    unarmed = polepair("set", URL, "2030h:3:u16=1", check=False)
    assert unarmed.returncode == 2 and "E219" in unarmed.stderr, unarmed.stderr
    assert node.sdo[0x2030][3].raw == 60000


TEXTS = ["Bob's 5\" \\drive\\ M\u00fcller\u200b", "red \x1b[31m, \x1b]0;title\x07 and \x9b2J", "two\nlines\tand a tab"]


@pytest.mark.parametrize("text", TEXTS)
def test_text_of_a_device_is_itself_in_data_and_escaped_in_a_terminal(node, text):
    node.object_dictionary[0x1008].default = text
    node.set_data(0x1008, 0, text.encode())
    shown = json.loads(polepair("get", URL, "1008h", "--format", "jsonl").stdout)
    assert shown["value"] == text
    [head, row] = csv.reader(io.StringIO(polepair("get", URL, "1008h", "--format", "csv").stdout))
    assert row[head.index("value")] == text
    escaped = "".join(f"\\x{ord(c):02x}" if ord(c) < 0x20 or 0x7F <= ord(c) < 0xA0 else c for c in text)
    escaped = escaped.replace("\\x0a", "\\n").replace("\\x09", "\\t")
    assert polepair("get", URL, "1008h").stdout == f"device name = {escaped}\n"
    said = polepair("info", URL, check=False)
    assert escaped in said.stdout
    with_polepair = polepair_module.connect(URL)
    with with_polepair as link:
        assert link.axis(NODE).read_text("1008h") == text


def test_text_and_bytes(node, tmp_path):
    assert polepair("get", URL, "1008h").stdout == "device name = Foreign node 0.1\n"
    assert "a text of its own" in polepair("get", URL, "0x2040:str").stdout
    # More than eight bytes without a type are bytes.
    assert "61 20 74" in polepair("get", URL, "0x2040").stdout
    saved = tmp_path / "saved.bin"
    polepair("get", URL, "1F50h:0:bytes", "-o", str(saved))
    assert saved.read_bytes() == bytes(range(256)) * 4
    given = tmp_path / "given.bin"
    given.write_bytes(os.urandom(1000))
    polepair("set", URL, f"1F50h:0:bytes=@{given}")
    assert node.data_store[0x1F50][0] == given.read_bytes()


def test_a_missing_object_is_reported_with_its_code(node):
    done = polepair("get", URL, "0x2099:1:u8", check=False)
    assert done.returncode == 6 and "0x06020000" in done.stderr, done.stderr
    done = polepair("get", URL, "0x2099:1", "-o", "/dev/null", check=False)
    assert done.returncode == 6 and "0x06020000" in done.stderr, done.stderr
    assert "a stop" not in done.stderr


def test_registers_of_pymodbus():
    server = Server(
        lambda device: ModbusTcpServer(device, framer=FramerType.RTU, address=("127.0.0.1", 0))
    )
    url = f"modbus-rtu+tcp://127.0.0.1:{server.port}?profile=modbus&timeout=5000#1"
    shown = polepair("get", url, "0x33", "R 51", "IR 7", "0x20:u32", "0x20:u32:le", "R 5:i16").stdout
    values = [int(line.split(" = ")[1]) for line in shown.splitlines()]
    assert values == [51, 51, 7, 32 << 16 | 33, 33 << 16 | 32, 5]
    polepair("set", url, "0x20:f32=1.5", "0x30:i64:le=-2", "R 1=0xFFFF", "--arm")
    shown = polepair("get", url, "0x20", "0x21", "0x30", "0x33", "R 1:i16").stdout
    values = [int(line.split(" = ")[1]) for line in shown.splitlines()]
    assert values == [0x3FC0, 0, 0xFFFE, 0xFFFF, -1]
    for wrong in ["R 1=65536", "R 1:i16=32768", "R 1:f32=1e300"]:
        refused = polepair("set", url, wrong, "--arm", check=False)
        assert refused.returncode == 2, f"{wrong}: {refused.stderr}"
    refused = polepair("get", url, "R 60000", check=False)
    assert refused.returncode == 6 and "code 2" in refused.stderr, refused.stderr
    server.close()


@pytest.mark.parametrize("framing", ["rtu", "ascii"])
def test_pymodbus_tells_its_device_identification(framing):
    identity = ModbusDeviceIdentification(
        info_name={
            "VendorName": "A vendor with a long name",
            "ProductCode": "XJ-7",
            "MajorMinorRevision": "V2.11",
            "ProductName": "1234567",
        }
    )
    framer = FramerType.RTU if framing == "rtu" else FramerType.ASCII
    server = Server(
        lambda device: ModbusTcpServer(
            device, framer=framer, address=("127.0.0.1", 0), identity=identity
        )
    )
    url = f"modbus-{framing}+tcp://127.0.0.1:{server.port}?timeout=5000#1"
    shown = polepair("info", url).stdout
    for fact in ["A vendor with a long name", "XJ-7", "V2.11", "1234567"]:
        assert fact in shown, shown
    sent = polepair("send", url, "read device id 0")
    assert sent.stdout == (
        'device id: vendor "A vendor with a long name", product code "XJ-7", revision "V2.11"\n'
    )
    server.close()
