"""python-can as a controller: raw frames of the protocol manual to our simulated thruster and servo."""

import socket
import time

import can
import pytest
from conftest import end, polepair, start
from polepair_test_support import wait_until
from test_can_links import GROUP, free_port, heard, own_echo, slcan, udp


class Controller:
    """Speaks the protocol from its printed frames alone."""

    def __init__(self, bus, node=11):
        self.bus, self.node = bus, node

    def send(self, data):
        message = can.Message(
            arbitration_id=0x300 + self.node, data=bytes.fromhex(data), is_extended_id=False
        )
        self.bus.send(message)

    def reply(self, timeout=120):
        """The data of the drive's next frame."""
        limit = time.monotonic() + timeout
        while time.monotonic() < limit:
            frame = heard(self.bus, timeout=limit - time.monotonic())
            if frame is not None and frame.arbitration_id == 0x280 + self.node:
                return bytes(frame.data)
        return None

    def ask(self, data, timeout=120):
        self.send(data)
        return self.reply(timeout)

    def ask_beside_reports(self, data):
        """The drive's next frame that begins as `data` does: it sends others by itself."""
        self.send(data)
        return next((reply for reply in iter(self.reply, None) if reply[:2] == bytes.fromhex(data)[:2]), None)

    def value(self, letters):
        data = self.ask(letters.encode().hex() + "0000")
        assert data is not None and data[:4] == letters.encode() + b"\0\0", data
        return int.from_bytes(data[6:], "big", signed=True)


@pytest.fixture(params=["udp", "slcan"])
def wire(request, tmp_path):
    """A function that starts a drive and gives its URL and python-can's bus, on either link."""
    running = []

    def make(drive):
        if request.param == "udp":
            port = free_port(socket.SOCK_DGRAM)
            process, url = start(f"{drive}:11", "--udp", f"{GROUP}:{port}")
            bus = own_echo(udp(port))
        else:
            path = str(tmp_path / "adapter")
            process, url = start(f"{drive}:11", "--pty", path)
            bus = slcan(path)
        running.append((process, bus))
        return url, Controller(bus)

    yield make
    for process, bus in running:
        bus.shutdown()
        end(process)


REFUSED = bytes.fromhex("0000EEEE")


def test_a_thruster_runs_by_printed_frames(wire):
    _, controller = wire("thruster")
    signal = "5443000000000005"
    assert controller.ask(signal)[4:] == REFUSED, "zero-point protection"
    assert controller.ask("45460000") == bytes.fromhex("4546000000000400")
    zero = "5443000000000000"
    for data in [zero, signal, "544300000000FFFB", "56430000000001F4"]:
        assert controller.ask(data) == bytes.fromhex(data)
    wait_until("the speed is 500", lambda: controller.value("QV"), lambda speed: abs(speed - 500) <= 2)
    assert controller.value("QP") == 480
    # Section 2.4: one frame without header, then two with, then none.
    assert controller.ask("564D000000000100") == bytes.fromhex("564D000000000100")
    bare = controller.ask("56430000000001F4")
    # It passes its speed before it settles.
    assert abs(int.from_bytes(bare[:2], "big") - 500) <= 25 and bare[2:4] == b"\x01\xe0", bare
    assert controller.ask("564D000000000003")[:2] == b"VM"
    assert controller.ask("56430000000001F4")[:2] == b"V\x01"
    assert controller.reply()[:2] == b"V\x02"
    assert controller.ask("564D000000000200")[:2] == b"VM"
    assert controller.ask("56430000000001F4", 2) is None
    assert controller.value("EF") == 0


def test_silence_stops_it_and_the_fault_is_reported_once(wire):
    _, controller = wire("thruster")
    for data in ["5443000000000000", "53540000000007D0", "5443000000000032"]:
        assert controller.ask(data) == bytes.fromhex(data)
    time.sleep(3)
    assert controller.value("EF") == 0x0800
    assert controller.value("EF") == 0
    assert controller.value("FR") == 0x0800


def test_a_servo_moves_and_sends_by_itself(wire):
    _, controller = wire("thruster-servo")
    assert controller.ask("4C41003C00000384") == bytes.fromhex("4C41003C00000384")
    wait_until("the angle is 900", lambda: controller.value("QA"), lambda angle: angle == 900)
    for _ in range(2):
        assert controller.ask("4C52003C00000032")[:2] == b"LR"
    wait_until("both steps are added", lambda: controller.value("QA"), lambda angle: angle == 1000)
    assert controller.ask("53504C41FC7C0384")[:4] == b"SPLA"
    assert controller.ask("4C41003C00000385")[4:] == REFUSED
    assert controller.ask("4D4D0000")[:2] == b"MM"
    letters = [controller.reply()[:2] for _ in range(4)]
    assert letters == [b"QC", b"QV", b"QC", b"QV"], letters
    assert controller.ask_beside_reports("4D510000") is not None
    assert controller.ask_beside_reports("4C53000000000000") == bytes.fromhex("4C53000000000000")


def test_our_host_beside_python_can_on_one_bus():
    port = free_port(socket.SOCK_DGRAM)
    process, url = start("thruster:11,12", "--udp", f"{GROUP}:{port}")
    try:
        with own_echo(udp(port)) as bus:
            polepair("spin", f"{url.split('#')[0]}#11", "600rpm", "--for", "500ms")
            ids = {frame.arbitration_id for frame in iter(lambda: heard(bus, 2), None)}
            assert ids <= {0x30B, 0x28B}, ids
            controller = Controller(bus, 12)
            assert controller.value("QP") == 480
            found = polepair("scan", url.split("#")[0], "--ids", "10-13", "--format", "jsonl")
            assert len(found.stdout.splitlines()) == 2, found.stdout
    finally:
        end(process)
