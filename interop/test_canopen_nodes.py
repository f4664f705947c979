"""python canopen against our CANopen nodes: network management, service and process data, LSS."""

import contextlib
import math
import os
import socket
import struct

import canopen
import pytest
from canopen_objects import dictionary
from conftest import end, polepair, start
from polepair_test_support import wait_until

GROUP = "239.74.163.2"
NODE = 2
# `make soak` says two megabytes.
BLOCK_BYTES = int(os.environ.get("POLEPAIR_BLOCK_BYTES", "500000"))


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]


@contextlib.contextmanager
def network(wire, words, tmp_path):
    """A simulated drive on a wire, and python canopen on it."""
    words = [words] if isinstance(words, str) else words
    master = canopen.Network()
    if wire == "udp":
        port = free_port()
        process, _ = start(*words, "--udp", f"{GROUP}:{port}")
        master.connect(
            interface="udp_multicast", channel=GROUP, port=port, receive_own_messages=False
        )
    else:
        path = str(tmp_path / "adapter")
        process, _ = start(*words, "--pty", path)
        master.connect(interface="slcan", channel=path, bitrate=500_000, sleep_after_open=0.1)
    try:
        yield master
    finally:
        master.disconnect()
        end(process)


@pytest.fixture(params=["udp", "slcan"])
def node(request, tmp_path):
    with network(request.param, "cia402:2", tmp_path) as master:
        remote = master.add_node(NODE, dictionary())
        remote.sdo.RESPONSE_TIMEOUT = 10
        yield remote


def test_states_boot_up_and_heartbeat(node):
    node.sdo[0x1017].raw = 50
    for state in ["OPERATIONAL", "STOPPED", "PRE-OPERATIONAL", "OPERATIONAL"]:
        node.nmt.state = state
        wait_until(f"a heartbeat with {state}", lambda: node.nmt.wait_for_heartbeat(10), lambda now: now == state)
    heard = []
    node.nmt.add_heartbeat_callback(heard.append)
    node.nmt.send_command(0x81)
    wait_until("the boot-up message", lambda: heard, lambda codes: 0 in codes)
    assert node.sdo[0x1017].raw == 0


def test_sdo_expedited_both_ways_and_aborts(node):
    assert node.sdo[0x1000].raw == 0x20192
    for index, value in [(0x6060, 3), (0x6071, -100), (0x60FF, -123_456), (0x6081, 4_000_000)]:
        node.sdo[index].raw = value
        assert node.sdo[index].raw == value
    for index, sub, code in [(0x5000, 0, 0x06020000), (0x1018, 9, 0x06090011)]:
        with pytest.raises(canopen.SdoAbortedError) as aborted:
            node.sdo.upload(index, sub)
        assert aborted.value.code == code
    with pytest.raises(canopen.SdoAbortedError) as aborted:
        node.sdo.download(0x6041, 0, b"\0\0")
    assert aborted.value.code == 0x06010002
    with pytest.raises(canopen.SdoAbortedError) as aborted:
        node.sdo.download(0x6040, 0, b"\0\0\0\0")
    assert aborted.value.code == 0x06070010


def pattern(size):
    return bytes((7 * n + n // 256) & 0xFF for n in range(size))


@pytest.mark.parametrize("size", [0, 1, 4, 5, 7, 8, 889, 1024])
def test_segments_keep_what_is_written(node, size):
    node.sdo.download(0x2F00, 0, pattern(size), force_segment=True)
    assert node.sdo.upload(0x2F00, 0) == pattern(size)


def test_segments_and_blocks_of_many_sizes(node):
    assert node.sdo[0x1008].raw == "Polepair CiA 402 drive"
    stream = node.sdo[0x2F01]
    for size in [0, 1, 6, 7, 8, 888, 889, 890, 3000]:
        stream[1].raw = size
        assert node.sdo.upload(0x2F01, 2) == pattern(size), size
        if size:
            with stream[2].open("rb", block_transfer=True) as file:
                assert file.read() == pattern(size), size
            with stream[2].open("wb", size=size, block_transfer=True) as file:
                file.write(pattern(size))
            assert stream[3].raw == size
    with pytest.raises(canopen.SdoAbortedError) as aborted:
        node.sdo.download(0x2F00, 0, pattern(1025), force_segment=True)
    assert aborted.value.code == 0x05040005


def test_many_blocks(tmp_path):
    with network("udp", "cia402:2", tmp_path) as master:
        node = master.add_node(NODE, dictionary())
        node.sdo.RESPONSE_TIMEOUT = 10
        stream, data = node.sdo[0x2F01], pattern(BLOCK_BYTES)
        with stream[2].open("wb", size=len(data), block_transfer=True) as file:
            file.write(data)
        assert stream[3].raw == len(data)


def test_pdos_are_mapped_and_go_with_sync(node):
    node.nmt.state = "PRE-OPERATIONAL"
    node.pdo.read()
    out, back = node.rpdo[1], node.tpdo[2]
    for pdo, objects in [(out, [0x60FF, 0x6071]), (back, [0x6041, 0x6064])]:
        pdo.clear()
        for index in objects:
            pdo.add_variable(index)
        pdo.trans_type, pdo.enabled = 1, True
    node.pdo.save()
    node.nmt.state = "OPERATIONAL"
    out[0x60FF].raw, out[0x6071].raw = 4321, -77
    heard = []
    back.add_callback(lambda pdo: heard.append([value.raw for value in pdo]))
    out.transmit()
    # A query is sent after it on the same wire.
    assert node.sdo[0x60FF].raw == 0, "it waits for SYNC"
    for n in range(1, 11):
        node.network.sync.transmit()
        wait_until(f"TPDO 2 follows SYNC {n}", lambda: heard, lambda rows: len(rows) == n)
    assert (node.sdo[0x60FF].raw, node.sdo[0x6071].raw) == (4321, -77)
    assert heard[-1][0] & 0x6F == 0x40


def test_a_change_is_reported_unasked(node):
    node.pdo.read()
    heard = []

    def hear(pdo):
        state = pdo[0].raw & 0x6F
        if heard[-1:] != [state]:  # it is told every 100 ms as well
            heard.append(state)

    node.tpdo[1].add_callback(hear)
    node.nmt.state = "OPERATIONAL"
    wait_until("TPDO 1 has the state 40h", lambda: heard, lambda states: states == [0x40])
    node.sdo[0x6040].raw = 6
    wait_until("TPDO 1 has the state 21h", lambda: heard, lambda states: states == [0x40, 0x21])


def test_an_emergency_and_its_end(node):
    heard = []
    node.emcy.add_callback(heard.append)
    node.sdo[0x1016][1].raw = 127 << 16 | 100
    node.nmt.state = "OPERATIONAL"
    node.network.send_message(0x77F, b"\x05")
    wait_until("an emergency message", lambda: heard)
    assert (heard[0].code, heard[0].register & 0x11) == (0x8130, 0x11)
    assert node.sdo[0x1003][1].raw == 0x8130
    node.network.send_message(0x77F, b"\x05")
    # The heartbeat stays away again after this one, and the next emergency follows.
    wait_until("the end of the emergency", lambda: [message.code for message in heard], lambda codes: 0 in codes)


def test_lss_gives_a_node_id(tmp_path):
    with network("udp", "cia402:2", tmp_path) as master:
        lss = master.lss
        lss.RESPONSE_TIMEOUT = 1
        assert lss.send_switch_state_selective(0xFFFF, 0x402, 0x10000, 2)
        assert lss.inquire_node_id() == 2
        assert lss.inquire_lss_address(0x5D) == 2
        lss.configure_node_id(33)
        lss.store_configuration()
        lss.send_switch_state_global(lss.WAITING_STATE)
        node = master.add_node(33, dictionary())
        master.send_message(0, struct.pack("BB", 0x82, 2))
        wait_until("node 33 replies", lambda: answers(master, 33))
        assert node.sdo[0x1018][4].raw == 2
        # Without a node-ID it is found by its numbers alone.
        lss.send_switch_state_global(lss.CONFIGURATION_STATE)
        lss.configure_node_id(255)
        lss.send_switch_state_global(lss.WAITING_STATE)
        master.send_message(0, struct.pack("BB", 0x82, 33))
        found, numbers = lss.fast_scan()
        assert found and numbers == [0xFFFF, 0x402, 0x10000, 2]
        lss.configure_node_id(5)
        lss.send_switch_state_global(lss.WAITING_STATE)
        master.add_node(5, dictionary())
        wait_until("node 5 replies", lambda: answers(master, 5))


def answers(master, node):
    try:
        return master[node].sdo[0x1000].raw == 0x20192
    except canopen.SdoCommunicationError:
        return False


def test_set_points_go_out_on_sync_at_their_rate(tmp_path):
    """A foreign listener hears a SYNC each cycle, and the set-points of both axes before it."""
    port = free_port()
    url = f"canopen+udp://{GROUP}:{port}?timeout=1000#1,2"
    lines = ["time s, 1 deg, 2 deg"]
    for k in range(101):
        angle = 20 * (1 - math.cos(k * math.tau / 100))
        lines.append(f"{k * 0.02:.3f},{angle:.6f},{-angle:.6f}")
    path = tmp_path / "path.csv"
    path.write_text("\n".join(lines) + "\n")
    process, _ = start("cia402:1,2", "--udp", f"{GROUP}:{port}")
    listener, heard = canopen.Network(), []
    listener.connect(interface="udp_multicast", channel=GROUP, port=port)
    for cob in (0x080, 0x201, 0x202, 0x181, 0x182):
        listener.subscribe(cob, lambda cob, data, at: heard.append((cob, bytes(data), at)))
    try:
        said = polepair("stream", url, str(path)).stderr
    finally:
        listener.disconnect()
        end(process)
    assert "101 cycles of 20 ms, axes: 2" in said
    syncs = [at for cob, _, at in heard if cob == 0x080]
    assert len(syncs) >= 101
    # Half of the beats are within a quarter of their period, however busy this machine is.
    steps = sorted(b - a for a, b in zip(syncs, syncs[1:]))
    assert abs(steps[len(steps) // 2] - 0.02) < 0.005
    # Between two SYNCs: a set-point for each axis, enable operation in its controlword.
    points = {cob: [] for cob in (0x201, 0x202)}
    between = []
    for cob, data, _ in heard:
        if cob == 0x080:
            assert [c for c in between if c in points] in ([0x201, 0x202], []), between
            between = []
            continue
        between.append(cob)
        if cob in points and len(data) == 6 and data[4] == 0x0F:
            points[cob].append(int.from_bytes(data[:4], "little", signed=True))
    # 40 degrees of 10,000 increments a turn, there and back.
    assert max(points[0x201]) == pytest.approx(1111, abs=2) and points[0x201][-1] == 0
    assert min(points[0x202]) == pytest.approx(-1111, abs=2) and points[0x202][-1] == 0
    assert sum(cob in (0x181, 0x182) for cob, _, _ in heard) >= 150
