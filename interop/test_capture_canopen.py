"""A bus of python canopen's nodes and master, captured by python-can: what we tell of it."""

import json
import subprocess
import time
from pathlib import Path

import can
import canopen
import pytest
from canopen_objects import dictionary
from conftest import POLEPAIR

NODES = (5, 6)
NAME = "A drive of python canopen"
# Long enough for a machine that is busy elsewhere to keep it within 2.5 periods.
HEARTBEAT_MS = 1000
MOTOR = Path(__file__).resolve().parent / "sheets" / "motor.eds"


def served(network):
    """Nodes as their own program has them."""
    for number in NODES:
        node = network.create_node(number, dictionary())
        node.sdo[0x1000].raw = 0x0002_0192
        node.sdo[0x1008].raw = NAME
        node.sdo[0x6041].raw = 0x0637
        node.nmt.send_command(0)
        yield node


def mapped(node):
    """TPDO 1 is the statusword and the position, under an identifier of its own."""
    node.sdo[0x1800][1].raw = 0x8000_0180 + node.id
    node.sdo[0x1A00][0].raw = 0
    node.sdo[0x1A00][1].raw = 0x6041_0010
    node.sdo[0x1A00][2].raw = 0x6064_0020
    node.sdo[0x1A00][0].raw = 2
    node.sdo[0x1800][1].raw = 0x1C0 + node.id


def work(drives, master, nodes):
    """Traffic of a machine in a few seconds."""
    for node in nodes:
        node.sdo.RESPONSE_TIMEOUT = 10
        assert node.sdo[0x1008].raw == NAME
        assert node.sdo[0x6041].raw == 0x0637
        node.sdo[0x1017].raw = HEARTBEAT_MS
        mapped(node)
    master.nmt.state = "OPERATIONAL"
    for step in range(20):
        for number in NODES:
            data = (0x0637).to_bytes(2, "little") + (-step).to_bytes(4, "little", signed=True)
            drives.send_message(0x1C0 + number, data)
        nodes[0].sdo[0x60FF].raw = 100 * step
        time.sleep(0.05)
    nodes[0].sdo[0x2F00].raw = bytes(range(200))
    master.nmt.state = "PRE-OPERATIONAL"
    time.sleep(2.2)
    master.nmt.send_command(0x81)
    time.sleep(2.2)


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """The log of a bus that is well."""
    path = tmp_path_factory.mktemp("bus") / "bus.log"
    place = {"interface": "virtual", "channel": str(path)}
    with can.Bus(**place) as tap:
        notifier = can.Notifier(tap, [can.CanutilsLogWriter(str(path), channel="can0")])
        drives, master = canopen.Network(), canopen.Network()
        drives.connect(**place)
        master.connect(**place)
        list(served(drives))
        work(drives, master, [master.add_node(number, dictionary()) for number in NODES])
        master.disconnect()
        drives.disconnect()
        notifier.stop()
    return path


def decoded(path, *words):
    done = subprocess.run(
        [POLEPAIR, "decode", str(path), "--as", "canopen", "--format", "jsonl", *words],
        capture_output=True, text=True, timeout=120, check=False,
    )
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def notices(frames, kind):
    told = [notice for frame in frames for notice in frame.get("notices", [])]
    return [notice for notice in told if notice["notice"] == kind]


def test_a_bus_that_is_well_has_nothing_odd(capture):
    frames = decoded(capture)
    assert notices(frames, "odd") == []
    assert [frame for frame in frames if frame.get("ok") is False] == []
    exchanges = notices(frames, "exchange")
    assert exchanges and all(exchange["outcome"] == "done" for exchange in exchanges)


def test_transfers_and_moved_process_data_are_named(capture):
    frames = decoded(capture)
    assert any(f'(0x1008:0, device name = "{NAME}"' in frame["text"] for frame in frames)
    places = [n for n in notices(frames, "signal") if n["name"] == "Actual/Position"]
    assert [n["exact"] for n in places if n["axis"] == 5] == [-step for step in range(20)]
    assert all(n["quality"] == "good" for n in places), places[:1]


def test_a_planted_fault_is_found_once(capture, tmp_path):
    lines = capture.read_text().splitlines()

    def odd(changed):
        path = tmp_path / "changed.log"
        path.write_text("\n".join(changed) + "\n")
        return [notice["kind"] for notice in notices(decoded(path), "odd")]

    reply = next(at for at, line in enumerate(lines) if "585#4B416000" in line)
    assert odd(lines[:reply] + lines[reply + 1:]) == ["unanswered"]
    assert odd(lines[:reply + 1] + lines[reply:]) == ["duplicate-reply"]
    toggled = [line.replace("605#70", "605#60", 1) if at < reply else line
               for at, line in enumerate(lines)]
    assert "sequence" in odd(toggled)
    process = [at for at, line in enumerate(lines) if "1C5#3706" in line][3]
    short = lines[process].split("#")[0] + "#3706"
    assert odd([*lines[:process], short, *lines[process + 1:]]) == ["length"]
    beats = [at for at, line in enumerate(lines) if "706#05" in line or "706#7F" in line]
    boot = lines[beats[0]].split("#")[0] + "#00"
    assert odd([*lines[:beats[0] + 1], boot, *lines[beats[0] + 1:]]) == ["restart"]


def test_a_data_sheet_names_what_the_capture_does_not(tmp_path):
    path = tmp_path / "bus.log"
    path.write_text("(1.0) can0 185#3706\n(1.1) can0 285#FFFFFFFF07000000\n")
    frames = decoded(path, "--profile", str(MOTOR))
    signals = {n["name"]: n for n in notices(frames, "signal")}
    assert signals["Actual/Position"]["exact"] == -1
    assert signals["State/Enabled"]["exact"] == 1
    assert all(n["quality"] == "good" for n in signals.values())
    own = [n for name, n in signals.items() if n["exact"] == 7]
    assert len(own) == 1 and own[0]["name"], signals


def test_a_configuration_is_read_as_the_node_is_configured(tmp_path):
    text = MOTOR.read_text().replace("\r\n", "\n")
    for before, after in [
        ("DefaultValue=1\nPDOMapping=0\n\n[1A00sub1]",
         "DefaultValue=1\nParameterValue=2\nPDOMapping=0\n\n[1A00sub1]"),
        ("DefaultValue=0x60410010\nPDOMapping=0\n\n[1A01]",
         "DefaultValue=0x60410010\nParameterValue=0x60640020\nPDOMapping=0\n\n"
         "[1A00sub2]\nParameterName=2\nObjectType=0x7\nDataType=0x0007\nAccessType=rw\n"
         "DefaultValue=0\nParameterValue=0x60410010\nPDOMapping=0\n\n[1A01]"),
    ]:
        assert text.count(before) == 1
        text = text.replace(before, after)
    sheet, path = tmp_path / "motor.dcf", tmp_path / "bus.log"
    sheet.write_text(text + "\n[DeviceComissioning]\nNodeID=5\nBaudrate=500\n")
    path.write_text("(1.0) can0 185#FEFFFFFF3706\n(1.1) can0 185#FEFF\n")
    frames = decoded(path, "--profile", str(sheet))
    signals = {n["name"]: n for n in notices(frames, "signal")}
    assert signals["Actual/Position"]["exact"] == -2
    assert signals["State/Enabled"]["exact"] == 1
    assert all(n["quality"] == "good" for n in signals.values())
    # The sheet's own mapping, once a frame fitted it, holds the others to its length.
    assert [notice["kind"] for notice in notices(frames, "odd")] == ["length"]
