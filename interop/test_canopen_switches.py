"""The TS answers what its manual names; switches of the simulated one turn the other services on."""

import contextlib
import struct

import can
import canopen
import pytest
from canopen_objects import dictionary
from conftest import occurs_within
from polepair_test_support import MAX_WAIT, wait_until
from test_canopen_nodes import NODE, network

RACK = """[[link]]
[[link.drive]]
profile = "syntron-ts-canopen"
address = 2
options = {{ {} }}
"""
REFUSED = 0x05040001
IDENTITY = [1, 2, 3, 4]
BOOT_UP = b"\0"


@contextlib.contextmanager
def drive(tmp_path, options=""):
    rack = tmp_path / "rack.toml"
    rack.write_text(RACK.format(options))
    with network("udp", str(rack), tmp_path) as master:
        node = master.add_node(NODE, dictionary())
        node.sdo.RESPONSE_TIMEOUT = 10
        yield node


def segmented(node):
    """The abort code of a segmented download; None when it is taken."""
    try:
        node.sdo.download(0x2033, 0, struct.pack("<H", 200), force_segment=True)
    except canopen.SdoAbortedError as aborted:
        return aborted.code
    return None


def selected(node):
    """Returns whether LSS finds the node by its identity."""
    numbers = [node.sdo[0x1018][sub].raw for sub in IDENTITY]
    lss = node.network.lss
    lss.RESPONSE_TIMEOUT = 1
    try:
        return lss.send_switch_state_selective(*numbers)
    except canopen.lss.LssError:
        return False


def guarded(node, patience=1):
    """The bytes that two guarding requests bring, each within so many seconds."""
    heard = []

    def hear(_id, data, _time):
        # A boot-up message has the same identifier (CiA 301, 7.2.8.3.3), and may come as late as now.
        if bytes(data) != BOOT_UP:
            heard.append(bytes(data))

    node.network.subscribe(0x700 + NODE, hear)
    for n in (1, 2):
        node.network.bus.send(
            can.Message(
                arbitration_id=0x700 + NODE, is_remote_frame=True, dlc=1, is_extended_id=False
            )
        )
        occurs_within(patience, lambda n=n: len(heard) == n)
    return heard


def test_a_request_outside_the_manual_gets_no_reply(tmp_path):
    with drive(tmp_path) as node:
        assert segmented(node) == REFUSED
        assert not selected(node)
        assert node.sdo[0x6041].raw == 0x50, "and it goes on"


def test_node_guarding_is_on_from_the_factory(tmp_path):
    with drive(tmp_path) as node:
        assert guarded(node, MAX_WAIT) == [b"\x7f", b"\xff"], "the toggle bit turns"
    with drive(tmp_path, 'guarding = "0"') as node:
        assert guarded(node) == []


def test_switches_turn_each_service_on(tmp_path):
    with drive(tmp_path, 'segments = "1"') as node:
        assert segmented(node) is None and node.sdo[0x2033].raw == 200
        assert not selected(node)
    with drive(tmp_path, 'lss = "1"') as node:
        assert selected(node) and node.network.lss.inquire_node_id() == NODE
        assert segmented(node) == REFUSED


def test_strict_it_is_a_node_by_the_standard(tmp_path):
    with drive(tmp_path, 'can = "strict"') as node:
        assert segmented(node) is None and selected(node)
        with pytest.raises(canopen.SdoAbortedError) as aborted:
            node.sdo.download(0x1600, 0, b"\0")
        assert aborted.value.code == 0x06010000, "the PDO is to be switched off first"


def test_pdos_are_mapped_after_the_start_without_the_invalid_bit(tmp_path):
    with drive(tmp_path) as node:
        node.nmt.state = "OPERATIONAL"
        for sub, data in [(0, b"\0"), (1, b"\x20\0\xff\x60"), (0, b"\1")]:
            node.sdo.download(0x1602, sub, data)
        node.network.send_message(0x402, struct.pack("<i", 100))
        wait_until("the PDO sets 60FFh", lambda: node.sdo[0x60FF].raw, lambda value: value == 100)


def test_fn_00_is_20_before_a_controlword_counts(tmp_path):
    def word(node):
        for word in (6, 7, 15):
            node.sdo[0x6040].raw = word
        return node.sdo[0x6041].raw & 0x7F

    with drive(tmp_path) as node:
        assert word(node) == 0x50
        node.sdo[0x2000].raw = 20
        assert word(node) == 0x37
    with drive(tmp_path, 'fn00 = "20"') as node:
        assert word(node) == 0x37


def test_node_id_and_bit_rate_are_parameters(tmp_path):
    with drive(tmp_path) as node:
        for value in (50, 800):
            node.sdo.download(0x209C, 0, struct.pack("<H", value))
        with pytest.raises(canopen.SdoAbortedError):
            node.sdo.download(0x209C, 0, struct.pack("<H", 1001))
        with pytest.raises(canopen.SdoAbortedError):
            node.sdo.download(0x209A, 0, struct.pack("<H", 128))
        node.sdo.download(0x209A, 0, struct.pack("<H", 9))
        assert node.sdo[0x6041].raw == 0x50, "until a reset it is node 2"
        other = node.network.add_node(9, dictionary())
        other.sdo.RESPONSE_TIMEOUT = 10
        heard = []
        other.nmt.add_heartbeat_callback(heard.append)
        node.nmt.send_command(0x81)
        wait_until("the boot-up message", lambda: heard, lambda codes: 0 in codes)
        assert other.sdo[0x6041].raw == 0x50
