"""Stops of drives that do not obey, do not say what they are, or do not tell now whether they stand."""

import os
import signal
import socket
import struct
import subprocess
import threading
import time

import pytest
from conftest import POLEPAIR, polepair
from faulty_drive import FaultyDrive, Rtu
from polepair_test_support import MAX_WAIT, wait_until
from test_evidence import exception

ABORT, WRITE, READ, SEGMENT = 0x80, 1, 2, 3
SOON = 0.25


def abort(frame, code):
    return bytes([ABORT]) + frame[1:4] + struct.pack("<I", code)


def reads(frame, *indices):
    return frame[0] >> 5 == READ and struct.unpack("<H", frame[1:3])[0] in indices


def turning(drive, rpm=60):
    polepair("spin", drive.url, f"{rpm}rpm", "--detach")
    assert wait_until("its speed", lambda: drive.values[0x606C, 0] != 0)
    drive.controls.clear()
    drive.frames.clear()


def text_of(run):
    return run.stdout + run.stderr


# --- A drive that does not obey its stop.


@pytest.mark.parametrize("rpm", [20, -300])
def test_a_stop_that_slows_nothing_becomes_a_quick_stop(odd, rpm):
    drive = odd()
    drive.ignores_halt = True
    # Nor does it take the set-point away.
    refuses = lambda frame: abort(frame, 0x06010002) if frame[:3] == b"\x23\xff\x60" else None
    turning(drive, rpm)
    drive.hook = refuses
    stopped = polepair("stop", drive.url)
    assert "a quick stop was sent" in text_of(stopped), stopped
    assert drive.state == 0x40 and drive.values[0x606C, 0] == 0
    assert [value for _, value in drive.controls if value == 0x02], drive.controls


def test_a_motor_that_brakes_slowly_gets_no_quick_stop(odd):
    drive = odd()
    turning(drive, 600)
    # Halt takes it down by 10 % in a second, and does so for three.
    drive.ignores_halt = True
    speed, began = drive.values[0x60FF, 0], time.monotonic()

    def brakes(frame):
        left = max(0.0, 1.0 - (time.monotonic() - began) * 0.1)
        if time.monotonic() - began > 3:
            drive.ignores_halt = False
        drive.values[0x60FF, 0] = round(speed * left)
        return None if frame[:3] != b"\x23\xff\x60" else bytes([0x60]) + frame[1:4] + bytes(4)

    drive.hook = brakes
    stopped = polepair("stop", drive.url)
    assert "quick stop" not in text_of(stopped), stopped
    assert all(value != 0x02 for _, value in drive.controls), drive.controls


@pytest.mark.parametrize("code", [0x08000022, 0x06090030])
def test_a_drive_that_refuses_its_stop_gets_the_other_one(odd, code):
    drive = odd()
    turning(drive)
    halt = lambda frame: frame[:3] == b"\x2b\x40\x60" and frame[4:6] == b"\x0f\x01"
    drive.hook = lambda frame: abort(frame, code) if halt(frame) else None
    stopped = polepair("stop", drive.url)
    assert "a quick stop was sent" in text_of(stopped), stopped
    assert drive.values[0x606C, 0] == 0


# --- A drive that does not say what it is.


def long_answer(size, segments, index=0x1000):
    """A hook: an object comes in segments of these bytes each, the last of them for ever."""
    sent = []

    def hook(frame):
        if reads(frame, index):
            sent.clear()
            return bytes([0x41 if size else 0x40]) + frame[1:4] + struct.pack("<I", size)
        if frame[0] >> 5 == SEGMENT:
            data = segments[min(len(sent), len(segments) - 1)]
            sent.append(data)
            return bytes([(frame[0] & 0x10) | (7 - len(data)) << 1]) + data.ljust(7, b"\0")
        return None

    return hook


def answers(head, value=b""):
    return lambda frame: (head + frame[1:4] + value).ljust(8, b"\0") if reads(frame, 0x1000) else None


ODD_IDENTITIES = {
    "busy": lambda frame: abort(frame, 0x08000022) if reads(frame, 0x1000) else None,
    "missing": lambda frame: abort(frame, 0x06020000) if reads(frame, 0x1000) else None,
    "general": lambda frame: abort(frame, 0x08000000) if reads(frame, 0x1000, 0x1018) else None,
    "zero": answers(b"\x43"),
    "ones": answers(b"\x43", b"\xff" * 4),
    "a byte": answers(b"\x4f", b"\x92"),
    "a clock": answers(b"\x43", b"\x91\x01\x02\x00"),
    "text": long_answer(11, [b"SERVO V"]),
    "without an end": long_answer(0, [b"ABCDEFG"]),
    "empty": long_answer(0, [b""]),
    "silent": lambda frame: b"" if reads(frame, 0x1000) else None,
    "dumb": lambda frame: b"" if frame[0] >> 5 != WRITE else None,
    "another object": answers(b"\x43\x01\x10\x00"),
}


@pytest.mark.parametrize("identity", ODD_IDENTITIES)
def test_a_named_node_with_an_odd_identity_is_stopped_at_once(odd, identity):
    drive = odd(node=9)
    turning(drive)
    drive.hook = ODD_IDENTITIES[identity]
    stopped = polepair("stop", drive.url, check=False, silence=True)
    assert stopped.returncode == 4, stopped
    assert "standstill is not confirmed" in stopped.stderr and "may still turn" in stopped.stderr
    assert drive.state == 0x40, "6040h = 2 leaves it without power"
    after = drive.controls[0][0] - drive.frames[0][0]
    # Time-outs are twice as long here.
    assert drive.controls[0][1] == 0x02 and after < 2 * SOON + 0.1, (after, drive.controls)


@pytest.mark.parametrize("code", [5, 6])
def test_a_modbus_drive_that_is_busy_is_stopped(code):
    def busy(number, request, reply):
        return [(0, exception(request, code))] if request[1] in (3, 4) else None

    drive = FaultyDrive(Rtu, busy)
    try:
        url = f"modbus-rtu+serial://{drive.path}?timeout=200&gap=0#1"
        stopped = polepair("stop", url, check=False, silence=True)
        assert stopped.returncode == 4 and "may still turn" in stopped.stderr, stopped
        assert drive.writes, "the stop of the known drives"
    finally:
        drive.close()


# --- A drive that refuses for the moment to report its speed.


@pytest.mark.parametrize("code", [0x08000022, 0x08000020, 0x05040000, 0x06060000])
@pytest.mark.parametrize("first", [True, False])
def test_a_busy_reading_is_asked_again(odd, code, first):
    drive = odd()
    turning(drive)
    until = []

    def busy(frame):
        if not reads(frame, 0x606C, 0x6064):
            return None
        until.append(time.monotonic())
        return abort(frame, code) if not first or until[-1] - until[0] < 0.8 else None

    drive.hook = busy
    stopped = polepair("stop", drive.url, check=False, silence=True)
    if first:
        assert stopped.returncode == 0 and "is stopped" in text_of(stopped), stopped
    else:
        assert stopped.returncode == 4 and "may still turn" in stopped.stderr, stopped
        assert "does not report" not in text_of(stopped), stopped


def test_an_object_that_is_missing_is_not_asked_for_ever(odd):
    drive = odd(without=(0x606C, 0x6064))
    stopped = polepair("stop", drive.url)
    assert "does not report whether its motor is at standstill" in text_of(stopped), stopped


# --- Ctrl-C.


@pytest.mark.parametrize("identity", ["silent", "busy"])
def test_ctrl_c_waits_until_the_stop_is_out(odd, identity):
    drive = odd()
    turning(drive)
    drive.hook = ODD_IDENTITIES[identity]
    environment = {**os.environ, "POLEPAIR_TIMEOUT_SCALE": "4"}
    words = [POLEPAIR, "stop", drive.url]
    stop = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, env=environment)
    assert wait_until("a frame", lambda: drive.frames)
    stop.send_signal(signal.SIGINT)
    _, told = stop.communicate(timeout=MAX_WAIT)
    assert stop.returncode == 130 and "the stop was sent; standstill is not confirmed" in told, told
    assert drive.state == 0x40, drive.controls


def test_a_second_ctrl_c_ends_a_stop_at_once(odd):
    drive = odd()
    drive.hook = ODD_IDENTITIES["dumb"]
    stop = subprocess.Popen([POLEPAIR, "stop", drive.url], stderr=subprocess.PIPE, text=True)
    assert wait_until("a frame", lambda: drive.frames)
    for _ in range(2):
        stop.send_signal(signal.SIGINT)
        # Sooner it would be the same press.
        time.sleep(0.4)
    _, told = stop.communicate(timeout=MAX_WAIT)
    assert stop.returncode == 130 and "a motor may still turn" in told, told


# --- Faults, power, set-points.


@pytest.mark.parametrize("sample_s", [0.004, 0.01, 0.06])
def test_a_fault_is_cleared_though_its_reset_bit_is_set_already(odd, sample_s):
    drive = odd()
    drive.sample_s = sample_s
    drive.fail(0x08)
    drive.values[0x6040, 0] = drive.old = 0x80
    polepair("clear", drive.url)
    assert drive.state == 0x40 and drive.values[0x6040, 0] == 0, drive.controls
    held = [after[0] - before[0] for before, after in zip(drive.controls, drive.controls[1:])]
    assert [value for _, value in drive.controls[:3]] == [0, 0x80, 0] and min(held[:2]) >= 0.02


def test_a_search_for_the_commutation_has_its_time(odd):
    drive = odd()
    drive.enable_s = 3.0
    assert "is powered" in text_of(polepair("enable", drive.url, silence=True))
    polepair("disable", drive.url)
    # Time-outs are longer here, but not those that the user says.
    ended = polepair("enable", drive.url, "--timeout", "500ms", check=False)
    assert ended.returncode == 1 and drive.state != 0x27, ended


@pytest.mark.parametrize(("state", "code", "exit_code"), [(0x08, "E801", 8), (0x40, "E102", 1)])
def test_a_fault_or_an_inhibit_ends_the_wait_for_power(odd, state, code, exit_code):
    drive = odd()
    drive.enable_s, inhibited = 60.0, []

    def inhibit(frame):
        if drive.power_at is not None and not inhibited:
            inhibited.append(time.monotonic())
            drive.fail(state)
        return None

    drive.hook = inhibit
    ended = polepair("enable", drive.url, check=False)
    assert ended.returncode == exit_code and code in ended.stderr, ended
    assert time.monotonic() - inhibited[0] < 5


@pytest.mark.parametrize("words", [["2turn"], ["0.5turn", "--rel"]])
def test_a_bit_12_that_stays_set_does_not_keep_an_axis_from_moving(odd, words):
    drive = odd()
    drive.keeps_ack = True
    polepair("move", drive.url, *words, "--vel", "300rpm")
    assert abs(drive.position - drive.per_turn * float(words[0][:-4])) <= 2, drive.position


PDO = {(0x1400, 1): 0x80000209, (0x1800, 1): 0x80000189}


def test_a_stream_that_cannot_be_prepared_leaves_the_axis_as_it_was(odd, tmp_path):
    entries = {(index, sub): 0 for index in (0x1600, 0x1A00) for sub in (1, 2, 3, 4)}
    drive = odd(objects=PDO | entries | {(0x1006, 0): 0})
    drive.sizes |= {(index, 2): 1 for index in (0x1400, 0x1800)}
    drive.sizes |= {(index, 0): 1 for index in (0x1600, 0x1A00)}
    drive.values |= dict.fromkeys(drive.sizes.keys() - drive.values.keys(), 0)
    drive.values[0x6502, 0] = 0x80 | drive.values[0x6502, 0]
    maps = lambda frame: frame[0] >> 5 == WRITE and frame[2] in (0x16, 0x1A)
    drive.hook = lambda frame: abort(frame, 0x08000022) if maps(frame) else None
    polepair("enable", drive.url)
    drive.controls.clear()
    path = tmp_path / "path.csv"
    path.write_text("time ms,5 deg\n0,0\n10,0.01\n20,0.02\n30,0.02\n")
    failed = polepair("stream", drive.url, str(path), check=False)
    assert failed.returncode == 6 and "disable the axis first" in failed.stderr, failed
    assert drive.state == 0x27 and not drive.controls, (hex(drive.state), drive.controls)


@pytest.mark.parametrize("segment", [b"", b"ENDLESS"])
def test_a_name_without_an_end_does_not_hold_a_scan_up(odd, segment):
    drive = odd()
    drive.hook = long_answer(0, [segment], index=0x1008)
    began = time.monotonic()
    shown = polepair("info", drive.url, silence=True)
    assert "the text does not end" in shown.stdout, shown
    assert time.monotonic() - began < 20


# --- Axes behind a relay to a bus with five bits for them.


class Listener(threading.Thread):
    """A silent line: it keeps the axes that were asked by TML on RS-232."""

    def __init__(self):
        super().__init__(daemon=True)
        self.server, self.axes = socket.create_server(("127.0.0.1", 0)), []
        self.start()

    def run(self):
        wire, _ = self.server.accept()
        text = b""
        while data := wire.recv(4096):
            text += data
            while len(text) > 2 and len(text) >= text[0] + 2:
                # Length of what follows, the check sum not counted; axis in bits 4 to 11.
                if 4 <= text[0] <= 12:
                    self.axes.append(struct.unpack(">H", text[1:3])[0] >> 4 & 0xFF)
                    text = text[text[0] + 2 :]
                else:
                    text = text[1:]


@pytest.mark.parametrize(("relay", "own"), [("&relay=technocan", 40), ("", 40)])
def test_behind_a_technocan_relay_each_axis_is_asked_by_one_number(relay, own):
    line = Listener()
    port = line.server.getsockname()[1]
    url = f"tml+tcp://127.0.0.1:{port}?timeout=5&through={own}{relay}"
    polepair("stop", url, check=False, silence=True)
    assert line.axes, "somebody was asked"
    assert (max(line.axes) > 31 + (own in line.axes)) or relay, sorted(set(line.axes))
    if relay:
        assert set(line.axes) <= {*range(32), own}, sorted(set(line.axes))
    line.server.close()
