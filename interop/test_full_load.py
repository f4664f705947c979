"""Recordings at the full speed of a line and of a bus are complete, or report their losses."""

import os
import pty
import re
import signal
import socket
import subprocess
import time
import tty

from conftest import POLEPAIR, occurs_within
from polepair_test_support import MAX_WAIT, wait_until

GROUP = "239.74.163.2"
BAUD, SECONDS = 921_600, 3
BIT_RATE, FRAME_BITS = 1_000_000, 130


class Recorder:
    """A `polepair record` that runs until `ended`."""

    def __init__(self, url, path):
        words = [POLEPAIR, "record", url, "-o", str(path)]
        self.process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
        while not (line := self.process.stderr.readline()).startswith("recording to"):
            assert line, "it ended"

    def ended(self):
        """Ends it. Returns the number of dropped frames, which agrees with the exit code."""
        self.process.send_signal(signal.SIGINT)
        said = self.process.communicate(timeout=MAX_WAIT)[1]
        dropped = int(re.search(r"(\d+) dropped", said)[1])
        assert self.process.returncode == (7 if dropped else 0), said
        return dropped


def words_of(path):
    """Lines of a log without their times."""
    return [line.split(" ", 2)[2] for line in path.read_text().splitlines()]


def test_a_serial_line_at_its_full_speed(tmp_path):
    ear, slave = pty.openpty()
    tty.setraw(slave)
    path = tmp_path / "line.log"
    recorder = Recorder(f"tmcl+serial://{os.ttyname(slave)}:{BAUD}", path)
    sent, began = bytearray(), time.monotonic()
    while (now := time.monotonic() - began) < SECONDS:
        # Ten bits a byte, as they would have come by now.
        due = int(now * BAUD / 10) - len(sent)
        chunk = bytes((len(sent) + n) * 31 % 251 for n in range(due))
        os.write(ear, chunk)
        sent += chunk
        time.sleep(0.001)

    def kept():
        return b"".join(bytes.fromhex(words) for words in words_of(path))

    wait_until(f"{len(sent)} bytes are in the file", lambda: len(kept()), lambda count: count == len(sent))
    assert recorder.ended() == 0
    assert kept() == sent
    os.close(ear)
    os.close(slave)


def test_a_bus_at_its_full_speed(tmp_path):
    count = SECONDS * BIT_RATE // FRAME_BITS
    frames = [f"{0x180 + n % 127:03X}#{n:016X}" for n in range(count)]
    capture = tmp_path / "full.log"
    capture.write_text("".join(
        f"({1700000000 + n * FRAME_BITS / BIT_RATE:.6f}) can0 {frame}\n"
        for n, frame in enumerate(frames)
    ))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        link = f"canopen+udp://{GROUP}:{probe.getsockname()[1]}"
    path = tmp_path / "bus.log"
    recorder = Recorder(link, path)
    polepair_replays(capture, link)

    def kept():
        return [words.split(" ")[0] for words in words_of(path)]

    occurs_within(2, lambda: len(kept()) == count)
    dropped, found = recorder.ended(), kept()
    # A machine that is busy elsewhere may lose some: then it says how many.
    assert len(found) + dropped == count
    assert dropped or found == frames


def polepair_replays(capture, link):
    words = ["replay", capture, link, "--as", "canopen", "--direction", "both", "--arm", "--detach"]
    done = subprocess.run([POLEPAIR, *words], capture_output=True, timeout=MAX_WAIT, check=False)
    assert done.returncode == 0, done.stderr.decode()
