"""Our CANopen host against python canopen's LocalNode, over UDP multicast."""

import os

import canopen
import pytest
from canopen.objectdictionary import ODRecord, ODVariable, ObjectDictionary, datatypes
from conftest import polepair

GROUP, PORT = "239.74.163.2", 43120 + os.getpid() % 1000
NODE = 5
URL = f"canopen+udp://{GROUP}:{PORT}?timeout=3000#{NODE}"


def variable(index, sub, name, kind, access, value):
    entry = ODVariable(name, index, sub)
    entry.data_type, entry.access_type = kind, access
    entry.value = entry.default = value
    return entry


def dictionary():
    """A node with what every device has."""
    made = ObjectDictionary()
    for index, name, kind, access, value in [
        (0x1000, "device type", datatypes.UNSIGNED32, "ro", 0),
        (0x1001, "error register", datatypes.UNSIGNED8, "ro", 0x81),
        (0x1017, "heartbeat time", datatypes.UNSIGNED16, "rw", 0),
    ]:
        made.add_object(variable(index, 0, name, kind, access, value))
    identity = ODRecord("identity", 0x1018)
    identity.add_member(variable(0x1018, 0, "entries", datatypes.UNSIGNED8, "ro", 4))
    for sub, (name, value) in enumerate(
        [("vendor", 0x319), ("product", 7), ("revision", 0x10002), ("serial", 4711)], 1
    ):
        identity.add_member(variable(0x1018, sub, name, datatypes.UNSIGNED32, "ro", value))
    made.add_object(identity)
    return made


@pytest.fixture
def node():
    network = canopen.Network()
    network.connect(interface="udp_multicast", channel=GROUP, port=PORT, receive_own_messages=False)
    local = network.create_node(NODE, dictionary())
    local.nmt.state = "PRE-OPERATIONAL"
    yield local
    network.disconnect()


def test_a_foreign_node_tells_what_every_device_has(node):
    said = polepair("get", URL, "vendor id", "serial number", "error register").stdout
    assert "793" in said and "4711" in said and "129" in said


def test_a_setting_is_written_and_read_back(node):
    polepair("set", URL, "heartbeat time=250")
    assert node.sdo[0x1017].raw == 250
    assert "250" in polepair("get", URL, "heartbeat time").stdout


def test_an_abort_is_reported_with_its_code(node):
    done = polepair("get", URL, "product code", check=False)
    assert done.returncode == 0
    del node.object_dictionary[0x1001]
    done = polepair("get", URL, "error register", check=False)
    assert done.returncode != 0 and "refused" in done.stderr


def test_a_scan_finds_the_node_and_no_other(node):
    said = polepair("scan", URL.split("#", maxsplit=1)[0], "--ids", "4-6", silence=True).stdout
    assert [line.split()[0] for line in said.splitlines() if line[:1].isdigit()] == [str(NODE)]


def test_an_address_without_a_drive_is_silent():
    done = polepair("get", URL, "vendor id", check=False, silence=True)
    assert done.returncode != 0 and "E401" in done.stderr
