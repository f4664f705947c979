"""Recordings of foreign clients at work on our drives: as they are they have no anomaly,
and for a planted fault `summary` names the time and the axis, and nothing else."""

import json
import os
import pty
import select
import signal
import socket
import statistics
import subprocess
import threading
import time
import tty

import can
import canopen
import pytest
from conftest import POLEPAIR, end, start
from polepair_test_support import MAX_WAIT, wait_until
from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient
from pytrinamic.connections import SerialTmclInterface
from pytrinamic.connections.can_tmcl_interface import CanTmclInterface

GROUP = "239.74.163.2"
ROUNDS = 40
# Exchanges after which the decoder knows whether a host takes turns: sixteen, and some more.
LEARNT = 20
# Time between two exchanges, s: there a fault has room.
REST = 0.005
# Longer pauses, s, are shortened to this: they come from a busy machine and not from a drive, and no drive replies
# more slowly than this for long.
LONGEST = 0.02
SLOWEST = 0.001
PLACES = 4


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]


class Tap:
    """A line between a client and a drive, and an adapter that hears both directions of it, as one on
    RS-485 does."""

    def __init__(self, drive):
        self.drive = os.open(drive, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self.drive)
        self.ends = [pty.openpty(), pty.openpty()]
        for _, slave in self.ends:
            tty.setraw(slave)
        (self.client, _), (self.ear, _) = self.ends
        self.client_path, self.ear_path = (os.ttyname(slave) for _, slave in self.ends)
        self.over = False
        self.thread = threading.Thread(target=self.pass_on)
        self.thread.start()

    def pass_on(self):
        towards = {self.client: self.drive, self.drive: self.client}
        while not self.over:
            for come in select.select(list(towards), [], [], 0.1)[0]:
                data = os.read(come, 4096)
                os.write(self.ear, data)
                os.write(towards[come], data)

    def close(self):
        self.over = True
        self.thread.join()
        for descriptor in [self.drive, *(it for pair in self.ends for it in pair)]:
            os.close(descriptor)


class Recorder:
    """`polepair record` beside a client."""

    def __init__(self, url, path):
        words = [POLEPAIR, "record", url, "-o", str(path)]
        self.path = path
        self.process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
        while not (line := self.process.stderr.readline()).startswith("recording to"):
            assert line, "it ended"

    def holds(self, frames):
        """Waits until so many frames are in the file, and ends."""
        wait_until(f"{frames} frames are in the file", lambda: len(frames_of(self.path)), lambda count: count >= frames)
        self.process.send_signal(signal.SIGINT)
        said = self.process.communicate(timeout=MAX_WAIT)[1]
        assert self.process.returncode == 0 and " 0 dropped" in said, said


class Frame:
    """A frame of a recording: when, its identifier as written, and its bytes."""

    def __init__(self, told):
        self.time, self.link = told["time"], told["link"]
        self.data = bytes.fromhex(told["bytes"])
        self.id = "" if told["id"] is None else f"{told['id']:03X}"

    def copy(self, time, data=None):
        made = Frame.__new__(Frame)
        made.time, made.link, made.id = time, self.link, self.id
        made.data = self.data if data is None else data
        return made

    def line(self):
        data = self.data.hex().upper()
        if self.id:
            return f"({self.time:.6f}) {self.link} {self.id}#{data}\n"
        return f"({self.time:.6f}) {self.link} {self.data.hex(' ').upper()}\n"


def frames_of(path):
    done = subprocess.run(
        [POLEPAIR, "decode", str(path), "--format", "jsonl"], capture_output=True, timeout=MAX_WAIT,
        check=False,
    )
    return [Frame(json.loads(line)) for line in done.stdout.splitlines()]


def summary(frames, path):
    """Runs `summary` on the frames. Returns its report, after a check that the exit code agrees."""
    path.write_text("".join(frame.line() for frame in frames))
    words = [POLEPAIR, "summary", str(path), "--format", "json"]
    done = subprocess.run(words, capture_output=True, timeout=MAX_WAIT, check=False)
    told = json.loads(done.stdout)
    assert done.returncode == (0 if told["clean"] else 1), done.stderr
    return told


def pytrinamic_serial(sim, tmp_path):
    tap = Tap(sim("tmcl:1"))
    recorder = Recorder(f"tmcl+serial://{tap.ear_path}", tmp_path / "recorded.log")
    module = SerialTmclInterface(tap.client_path, 115200, timeout_s=30)
    for _ in range(ROUNDS):
        module.get_axis_parameter(1, 0)
        time.sleep(REST)
        module.get_axis_parameter(3, 0)
        time.sleep(REST)
    module.close()
    recorder.holds(4 * ROUNDS)
    tap.close()
    return recorder.path, None, 1


def pymodbus_by(framer):
    def work(sim, tmp_path):
        tap = Tap(sim(f"modbus-{framer.value}:1"))
        recorder = Recorder(f"modbus-{framer.value}+serial://{tap.ear_path}", tmp_path / "recorded.log")
        client = ModbusSerialClient(tap.client_path, framer=framer, baudrate=115200, timeout=10)
        assert client.connect()
        for _ in range(ROUNDS):
            for address, count in [(0x1000, 1), (0x1008, 2)]:
                assert not client.read_holding_registers(address, count=count, device_id=1).isError()
                time.sleep(REST)
        client.close()
        recorder.holds(4 * ROUNDS)
        tap.close()
        return recorder.path, None, 1
    return work


def served(words, tmp_path):
    port = free_port()
    process, url = start(words, "--udp", f"{GROUP}:{port}")
    recorder = Recorder(url.split("#")[0], tmp_path / "recorded.log")
    bus = can.Bus(
        interface="udp_multicast", channel=GROUP, port=port, receive_own_messages=False
    )
    return process, recorder, bus


class UdpTmclInterface(CanTmclInterface):
    """The client's CAN interface on a bus of python-can that it does not offer itself."""

    def __init__(self, bus):
        CanTmclInterface.__init__(self, GROUP, 0, 2, 1, 30)
        self._connection = bus
        bus.set_filters([{"can_id": 2, "can_mask": 0x7FF}])


def pytrinamic_can(sim, tmp_path):
    process, recorder, bus = served("tmcl:1", tmp_path)
    module = UdpTmclInterface(bus)
    for _ in range(ROUNDS):
        module.get_axis_parameter(1, 0)
        time.sleep(REST)
        module.get_axis_parameter(3, 0)
        time.sleep(REST)
    recorder.holds(4 * ROUNDS)
    module.close()
    end(process)
    return recorder.path, "002", 1


def python_canopen(sim, tmp_path):
    process, recorder, bus = served("canopen:5", tmp_path)
    network = canopen.Network(bus)
    network.connect()
    sdo = network.add_node(5, canopen.ObjectDictionary()).sdo
    sdo.RESPONSE_TIMEOUT = 30
    for _ in range(ROUNDS):
        for index in [0x6041, 0x6064]:
            sdo.upload(index, 0)
            time.sleep(REST)
    recorder.holds(4 * ROUNDS)
    network.disconnect()
    end(process)
    return recorder.path, "585", 5


CLIENTS = {
    "pytrinamic-serial": pytrinamic_serial,
    "pytrinamic-can": pytrinamic_can,
    "pymodbus-rtu": pymodbus_by(FramerType.RTU),
    "pymodbus-ascii": pymodbus_by(FramerType.ASCII),
    "python-canopen": python_canopen,
}


def lost(frames, at):
    del frames[at]


def doubled(frames, at):
    frames.insert(at + 1, frames[at].copy(frames[at].time + 0.0003))


def late(frames, at):
    frames[at:] = [frame.copy(frame.time + 1.5) for frame in frames[at:]]


def sent_again(frames, at):
    frames.insert(at, frames[at - 1].copy((frames[at - 1].time + frames[at].time) / 2))


def foreign(frames, at):
    before = next(it for it in frames[at - 2::-2] if it.id == frames[at].id)
    frames.insert(at + 1, before.copy((frames[at].time + frames[at + 1].time) / 2))


def cut(frames, at):
    frames[at] = frames[at].copy(frames[at].time, frames[at].data[:4])


def flipped(frames, at):
    data = bytearray(frames[at].data)
    data[-3] ^= 1
    frames[at] = frames[at].copy(frames[at].time, bytes(data))


def noise(frames, at):
    frames.insert(at + 1, frames[at].copy(frames[at].time + 0.0005, b"\x01"))


FAULTS = {
    lost: {"unanswered"},
    doubled: {"duplicate-reply"},
    late: {"late-reply"},
    sent_again: {"retry"},
    foreign: {"foreign-reply", "duplicate-reply", "duplicate-address"},
    cut: {"stray", "malformed", "bad-check"},
    flipped: {"bad-check", "stray"},
    noise: {"stray"},
}
# Faults of bytes, which CAN does not have: its controllers check frames.
SERIAL = (cut, flipped, noise)


def steady(frames, is_answer):
    """The same, without what the machine's other work made of it: answers take about as long as most do. To a host
    that takes turns, one that comes much sooner than all before belongs to an earlier request."""
    gaps = [frame.time - before.time for before, frame in zip([frames[0], *frames], frames)]
    usual = min(statistics.median(gap for at, gap in enumerate(gaps) if is_answer(at)), SLOWEST)
    made, now = [], frames[0].time
    for at, (gap, frame) in enumerate(zip(gaps, frames)):
        now += min(max(gap, 0.7 * usual), 1.3 * usual) if is_answer(at) else min(gap, LONGEST)
        made.append(frame.copy(now))
    return made


@pytest.mark.parametrize("client", CLIENTS)
def test_a_planted_fault_is_found_and_nothing_else(client, sim, tmp_path):
    path, replies, axis = CLIENTS[client](sim, tmp_path)
    recorded = frames_of(path)

    def is_answer(at):
        """One asks, the other answers."""
        return recorded[at].id == replies if replies else at % 2 == 1

    clean = steady(recorded, is_answer)
    scratch = tmp_path / "changed.log"
    told = summary(clean, scratch)
    assert told["clean"], told["moments"]
    answers = [at for at in range(len(clean)) if is_answer(at)][LEARNT:-8]
    assert len(answers) >= ROUNDS, len(clean)
    wrong = []
    for plant, kinds in FAULTS.items():
        if replies and plant in SERIAL:
            continue
        for at in answers[::len(answers) // PLACES]:
            frames, since = list(clean), clean[at].time
            plant(frames, at)
            found = summary(frames, scratch)["moments"]
            right = [it for it in found if it["kind"] in kinds and it["count"] == 1
                     and it["axis"] in (None, axis) and since - 0.05 < it["time"] < since + 1.6]
            if len(right) != 1 or len(found) != 1:
                wrong.append((plant.__name__, at, [(it["kind"], it["text"]) for it in found]))
    assert not wrong, wrong
