"""Drives whose bits, answers and lost acknowledgements say more, or less, than what happened."""

import re
import socket
import struct
import threading
import time

import pytest
from conftest import end, polepair, start
from faulty_drive import FaultyDrive, Rtu, crc
from polepair_test_support import wait_until


# --- Motion: the statusword only says when to look.


@pytest.mark.parametrize("seconds", [0.002, 0.08, 0.6])
@pytest.mark.parametrize("per_turn", [10_000, 1 << 17])
def test_a_bit_of_the_move_before_is_no_arrival(odd, seconds, per_turn):
    drive = odd(per_turn=per_turn)
    drive.stale_reached_s = seconds
    for turns in (1, 2):
        moved = polepair("move", drive.url, "1turn", "--rel", "--vel", "120rpm")
        # Each move ends within 0.5 deg of its target.
        window = turns * 0.5 / 360 + 1 / per_turn
        assert abs(drive.position / per_turn - turns) <= window, drive.position
        told = re.fullmatch(r"position = ([0-9.]+) turn", moved.stdout.splitlines()[-1])
        assert told and abs(float(told[1]) - turns) <= window, moved


@pytest.mark.parametrize(("at", "turns"), [(0, "0"), (5000, "0.5")])
def test_a_limit_with_the_bit_of_an_arrival_is_a_limit(odd, at, turns):
    drive = odd()
    drive.limit_at = at
    failed = polepair("move", drive.url, "2turn", "--rel", "--vel", "60rpm", check=False)
    assert failed.returncode == 1 and "E106" in failed.stderr, failed
    stopped = re.search(r"reached at ([0-9.]+) turn; the target is 2 turn; (.*) holds", failed.stderr)
    assert stopped and abs(float(stopped[1]) - float(turns)) < 0.05, failed
    assert "limit" in stopped[2], failed


@pytest.mark.parametrize("after", [0.002, 0.004, 0.02])
def test_a_relative_move_whose_frames_are_doubled_is_reported(odd, after):
    drive = odd()
    drive.doubled_after = after
    moved = polepair("move", drive.url, "1turn", "--rel", "--vel", "120rpm", check=False)
    if moved.returncode == 0:
        assert abs(drive.position - 10_000) <= 1, (drive.position, moved)
        return
    # A doubled controlword may switch it off as well, before the move (E101) or during it (E102).
    reported = re.search(r"\bE10[126]\b", moved.stderr)
    assert reported, moved
    if reported[0] == "E101":
        before = drive.position
        time.sleep(0.2)
        assert drive.position == before, (before, drive.position, moved)
    if reported[0] != "E106":
        return
    assert "the target is 1 turn" in moved.stderr, moved
    told = re.search(r" at ([0-9.]+) turn; .*; it started at 0 turn", moved.stderr)
    # It is stopped after that.
    assert told and abs(float(told[1]) - drive.position / 10_000) < 0.2, (drive.position, moved)


class LosesAcknowledgement(threading.Thread):
    """A wire to a simulated TML drive that loses the n-th acknowledgement of UPD, which starts a motion."""

    UPD, ACK = b"\x01\x08", 0x4F

    def __init__(self, port, number):
        super().__init__(daemon=True)
        self.port, self.number, self.starts, self.lost, self.due = port, number, 0, 0, False
        self.server = socket.create_server(("127.0.0.1", 0))
        self.start()

    def run(self):
        while True:
            try:
                host, _ = self.server.accept()
            except OSError:
                return
            drive = socket.create_connection(("127.0.0.1", self.port))
            for one in (host, drive):
                one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for route in (self.there, self.back):
                threading.Thread(target=route, args=(host, drive), daemon=True).start()

    def there(self, host, drive):
        text = b""
        while data := host.recv(4096):
            text += data
            # Length of what follows, the check sum not counted; axis; instruction.
            while text and len(text) >= text[0] + 2:
                message, text = text[: text[0] + 2], text[text[0] + 2 :]
                if message[3:5] == self.UPD:
                    self.starts += 1
                    self.due = self.starts == self.number
                drive.sendall(message)
        drive.shutdown(socket.SHUT_RDWR)

    def back(self, host, drive):
        while data := drive.recv(4096):
            if self.due and self.ACK in data:
                at = data.index(self.ACK)
                data, self.due = data[:at] + data[at + 1 :], False
                self.lost += 1
            try:
                host.sendall(data)
            except OSError:
                return


@pytest.mark.parametrize("way", [5000, -300])
def test_a_start_whose_acknowledgement_is_lost_is_looked_for(way):
    process, url = start("tml:255", "--tcp", "127.0.0.1:0")
    port = int(re.search(r":(\d+)#", url)[1])
    wire = LosesAcknowledgement(port, 1)
    lossy = url.replace(str(port), str(wire.server.getsockname()[1]))
    try:
        words = [lossy, "--raw", "--rel", "--", str(way)]
        polepair("move", *words)
        assert (wire.starts, wire.lost) == (1, 1), "it was sent once, and the answer was lost"
        shown = polepair("get", url, "APOS", "--raw").stdout
        assert abs(int(shown.split()[-1]) - way) <= 2, shown
    finally:
        end(process)
        wire.server.close()


# --- Standstill in units.


def test_a_speed_of_many_counts_with_noise_is_standstill(odd):
    counts = 1 << 24
    drive = odd(per_turn=counts)
    drive.noise = 4000
    polepair("spin", drive.url, "10rpm", "--detach")
    wait_until(
        "the motor moves",
        lambda: polepair("info", drive.url).stdout,
        lambda shown: re.search(r"moving +yes", shown),
    )
    stopped = polepair("stop", drive.url)
    assert "stopped" in stopped.stdout + stopped.stderr, stopped
    assert abs(drive.values[0x606C, 0]) < 4000


def test_a_byte_is_no_position(odd):
    drive = odd(arrays={0x606C: 3, 0x6064: 2})
    shown = polepair("info", drive.url).stdout
    assert not re.search(r"^  (position|velocity) +-?[0-9]", shown, re.MULTILINE), shown
    stopped = polepair("stop", "--quick", drive.url, check=False)
    assert "is stopped" not in stopped.stdout + stopped.stderr, stopped
    assert drive.old & 0x0F == 0x02, hex(drive.old)


# --- Writes: the outcome is the write's own.


def test_an_object_that_cannot_be_read_is_written(odd):
    drive = odd(objects={(0x2001, 0): 0})
    drive.write_only.add((0x2001, 0))
    written = polepair("set", drive.url, "0x2001:0:u32=5", "--arm")
    assert (0x2001, 5) in drive.writes
    assert "could not be read back" in written.stdout + written.stderr, written


def modbus(fault):
    drive = FaultyDrive(Rtu, fault)
    return drive, f"modbus-rtu+serial://{drive.path}?timeout=400&gap=0&profile=modbus#1"


def exception(request, code):
    head = bytes([request[0], request[1] | 0x80, code])
    return head + crc(head)


def reads(function, code, but=()):
    """A fault: registers from 0xF0 on are not read by this function."""

    def fault(number, request, reply):
        register = struct.unpack(">H", request[2:4])[0]
        refused = request[1] in (3, 4) and register >= 0xF0
        return [(0, exception(request, code))] if refused else None

    return fault


@pytest.mark.parametrize("code", [1, 2])
def test_a_register_that_cannot_be_read_is_written(code):
    drive, url = modbus(reads(3, code))
    try:
        written = polepair("set", url, "0xF6:u32=0x00020064", "--arm", check=False)
        assert [start for start, _ in drive.writes] == [0xF6], (drive.writes, written)
        text = written.stdout + written.stderr
        assert "could not be read back" in text and "not executed" not in text, written
        assert written.returncode == 0, written
    finally:
        drive.close()


def test_a_busy_drive_is_asked_again():
    refused = []

    def busy(number, request, reply):
        # The answer says that the drive is busy: it did not take the value.
        if request[1] in (6, 16) and len(refused) < 2:
            refused.append(drive.writes.pop())
            return [(0, exception(request, 6))]
        return None

    drive, url = modbus(busy)
    try:
        polepair("set", url, "0x30:u16=48", "--arm")
        assert len(refused) == 2 and drive.writes == [(0x30, 48)], drive.writes
    finally:
        drive.close()


def test_an_accepted_write_is_read_back():
    def later(number, request, reply):
        return [(0, exception(request, 5))] if request[1] in (6, 16) else None

    drive, url = modbus(later)
    try:
        # Each register holds its own number: 48 is present already, 7 never is.
        polepair("set", url, "0x30:u16=48", "--arm")
        kept = polepair("set", url, "0x30:u16=7", "--arm", check=False)
        assert kept.returncode == 1 and "48" in kept.stdout + kept.stderr, kept
        assert drive.writes == [(0x30, 48), (0x30, 7)], drive.writes
    finally:
        drive.close()
