"""python-can on our CAN links: a gateway of ours joins two of them, python-can sits at both ends."""

import socket
import subprocess
import time

import can
import pytest
from conftest import EXAMPLES, end, polepair, start

GATEWAY = EXAMPLES / "can_gateway"
GROUP = "239.74.163.2"
RATE = 500_000

FRAMES = [
    can.Message(arbitration_id=0x123, data=b"\xde\xad\xbe\xef", is_extended_id=False),
    can.Message(arbitration_id=0x7FF, data=b"", is_extended_id=False),
    can.Message(arbitration_id=0x1F334455, data=bytes(range(1, 9))),
    can.Message(arbitration_id=0, data=b"\x00", is_extended_id=True),
]
REMOTE = [
    can.Message(arbitration_id=0x77, is_remote_frame=True, dlc=4, is_extended_id=False),
    can.Message(arbitration_id=0x1ABCDEF0, is_remote_frame=True, dlc=8),
]


@pytest.fixture
def gateway():
    """A function that joins two links and gives what the program calls them."""
    running = []

    def join(one, other):
        process = subprocess.Popen(
            [GATEWAY, one, other], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        running.append(process)
        names = [process.stdout.readline().split() for _ in range(2)]
        assert all(name and name[0] == "ready" for name in names), names
        return [name[1] for name in names]

    yield join
    for process in reversed(running):
        told, _ = process.communicate(timeout=120)
        assert process.returncode == 0, told
        assert told.count("overrun: 0") == 2, told


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]


def udp(port):
    return can.Bus(interface="udp_multicast", channel=GROUP, port=port, hop_limit=0)


def slcan(channel, bitrate=RATE):
    bus = can.Bus(interface="slcan", channel=channel, bitrate=bitrate, sleep_after_open=0.1)
    assert bus.get_version(60) == (10, 13), "answered once it is open"
    return bus


def socketcand(address):
    host, port = address.rsplit(":", 1)
    return can.Bus(interface="socketcand", host=host, port=int(port), channel="can0")


def same(sent, got):
    fields = ("arbitration_id", "is_extended_id", "is_remote_frame", "dlc", "data")
    return got is not None and all(getattr(sent, name) == getattr(got, name) for name in fields)


def exchange(one, other, frames):
    for sender, receiver in [(one, other), (other, one)]:
        for frame in frames:
            sender.send(frame)
            got = heard(receiver)
            assert same(frame, got), f"{frame} became {got}"


def heard(bus, timeout=120):
    """The next frame. python-can's udp_multicast hears itself: what it sent is passed over."""
    end = time.monotonic() + timeout
    sent = bus.__dict__.setdefault("echoes", [])
    while time.monotonic() < end:
        got = bus.recv(0.2)
        echo = next((frame for frame in sent if got is not None and same(frame, got)), None)
        if echo is not None:
            sent.remove(echo)
        elif got is not None:
            return got
    return None


def own_echo(bus):
    """Makes the bus skip the echo of each frame that it sends."""
    send = bus.send

    def noted(frame, timeout=None):
        bus.__dict__.setdefault("echoes", []).append(frame)
        send(frame, timeout)

    bus.send = noted
    return bus


# TMCL on CAN, 250 kbit/s from the factory: module 1, read axis parameter 6 (maximum current); the answer comes to the host, 2.
ASK = can.Message(arbitration_id=1, data=[6, 6, 0, 0, 0, 0, 0], is_extended_id=False)
ANSWER = bytes([1, 100, 6])


@pytest.mark.parametrize("wire", ["udp", "pty", "tcp", "socketcand"])
def test_python_can_talks_to_simulated_drives(wire, tmp_path):
    port = free_port(socket.SOCK_DGRAM)
    path = str(tmp_path / "adapter")
    words, join = {
        "udp": (["--udp", f"{GROUP}:{port}"], lambda at: udp(port)),
        "pty": (["--pty", path], lambda at: slcan(path, 250_000)),
        "tcp": (["--tcp", "127.0.0.1:0"], lambda at: slcan(f"socket://{at}", 250_000)),
        "socketcand": (["--socketcand", "127.0.0.1:0"], lambda at: socketcand(at.split("/")[0])),
    }[wire]
    process, url = start("tmcl+can:1", *words)
    try:
        place = url.split("://")[1].split("?")[0].split("#")[0]
        with join(place) as bus:
            bus.send(ASK)
            got = next(frame for frame in iter(lambda: heard(bus), None) if not same(ASK, frame))
            assert got.arbitration_id == 2 and got.data[:3] == ANSWER, got
            value = int.from_bytes(got.data[3:], "big")
        if wire != "pty":  # which python-can has just left
            told = polepair("get", url, "max current", "--raw").stdout
            assert value > 0 and str(value) in told, (value, told)
    finally:
        end(process)


def test_udp_multicast_and_slcan_on_a_pty(gateway, tmp_path):
    port = free_port(socket.SOCK_DGRAM)
    path = tmp_path / "can"
    gateway(f"udp:{GROUP}:{port}", f"slcan-pty:{path}?{RATE}")
    with own_echo(udp(port)) as one, slcan(str(path)) as other:
        exchange(one, other, FRAMES + REMOTE)
        assert other.get_serial_number(60) == "PLPR"


def test_slcan_over_tcp_and_socketcand(gateway):
    adapter, server = gateway(f"slcan-listen:0?{RATE}", "socketcand-listen:0/can0")
    with slcan(f"socket://{adapter}") as one, socketcand(server) as other:
        exchange(one, other, FRAMES)


def test_several_clients_share_a_bus(gateway):
    adapter, server = gateway(f"slcan-listen:0?{RATE}", "socketcand-listen:0/can0")
    clients = [slcan(f"socket://{adapter}"), slcan(f"socket://{adapter}")]
    clients += [socketcand(server), socketcand(server)]
    for n, speaker in enumerate(clients):
        frame = can.Message(arbitration_id=0x100 + n, data=[n], is_extended_id=False)
        speaker.send(frame)
        for listener in clients:
            if listener is not speaker:
                assert same(frame, heard(listener)), n
    assert [client.recv(0.05) for client in clients] == [None] * 4
    for client in clients:
        client.shutdown()


def test_our_clients_reach_our_servers_end_to_end(gateway):
    """python-can, slcan server, client, socketcand server, client, UDP, python-can."""
    port = free_port(socket.SOCK_DGRAM)
    adapter, server = gateway(f"slcan-listen:0?{RATE}", "socketcand-listen:0/can0")
    gateway(f"socketcand:{server}/can0", f"udp:{GROUP}:{port}")
    with slcan(f"socket://{adapter}") as one, own_echo(udp(port)) as other:
        exchange(one, other, FRAMES)


def test_a_wrong_bit_rate_neither_receives_nor_is_received(gateway, tmp_path):
    path = tmp_path / "can"
    _, server = gateway(f"slcan-pty:{path}?{RATE}", "socketcand-listen:0/can0")
    with slcan(str(path), 250_000) as wrong, socketcand(server) as other:
        wrong.send(FRAMES[0])
        other.send(FRAMES[0])
        assert wrong.recv(0.2) is None
        assert other.recv(0.2) is None


def test_a_burst_arrives_whole_and_in_order(gateway, tmp_path):
    port = free_port(socket.SOCK_DGRAM)
    path = tmp_path / "can"
    gateway(f"udp:{GROUP}:{port}", f"slcan-pty:{path}?{RATE}")
    with udp(port) as one, slcan(str(path)) as other:
        # The kernel keeps 256 datagrams for a gateway that a busy machine does not let run.
        for first in range(0, 1000, 200):
            burst = range(first, first + 200)
            for n in burst:
                data = n.to_bytes(2, "big")
                one.send(can.Message(arbitration_id=0x200, data=data, is_extended_id=False))
            assert [int.from_bytes(heard(other).data, "big") for _ in burst] == list(burst)
