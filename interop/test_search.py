"""Drives on ports of which neither protocol nor baud rate is known, found by `polepair scan`."""

from __future__ import annotations

import csv
import io
import json
import os
import pty
import select
import signal
import subprocess
import termios
import threading
import time
import tty

import pytest
from conftest import POLEPAIR, polepair

RATES = {termios.B9600: 9_600, termios.B19200: 19_200, termios.B57600: 57_600, termios.B115200: 115_200}


class TmclModule:
    """A TMCM-1140 on a pty that understands only what is sent at its own baud rate. One that holds part of a datagram
    keeps it however long the pause is."""

    def __init__(self, rate: int, address: int, held: bytes | None = None) -> None:
        self.rate, self.address, self.held = rate, address, held
        self.commands: list[int] = []
        self.ours, self.theirs = pty.openpty()
        tty.setraw(self.theirs)
        self.path = os.ttyname(self.theirs)
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.serve)
        self.thread.start()

    def serve(self) -> None:
        pending = self.held or b""
        while not self.ended.is_set():
            if not select.select([self.ours], [], [], 0.01)[0]:
                pending = b"" if self.held is None else pending
                continue
            received = os.read(self.ours, 64)
            if RATES.get(termios.tcgetattr(self.theirs)[5]) != self.rate:
                continue
            pending += received
            while len(pending) >= 9:
                frame, pending = pending[:9], pending[9:]
                if sum(frame[:8]) % 256 == frame[8] and frame[0] == self.address:
                    self.answer(frame)

    def answer(self, frame: bytes) -> None:
        self.commands.append(frame[1])
        value = 0x0474_0120 if frame[1] == 136 else 0
        body = bytes([2, self.address, 100, frame[1]]) + value.to_bytes(4, "big")
        os.write(self.ours, body + bytes([sum(body) % 256]))

    def close(self) -> None:
        self.ended.set()
        self.thread.join()
        os.close(self.ours)
        os.close(self.theirs)


@pytest.fixture
def module(request):
    made = TmclModule(*request.param)
    yield made
    made.close()


@pytest.mark.parametrize("module", [(9_600, 1), (115_200, 1), (9_600, 1, b"\x3a\x0d\x55")], indirect=True)
def test_a_module_is_found_at_its_rate_and_address(module):
    found = [json.loads(line) for line in polepair("scan", module.path, "--format", "jsonl", silence=True).stdout.splitlines()]
    assert [one["url"] for one in found] == [f"tmcl+serial://{module.path}:{module.rate}#{module.address}"]
    assert found[0]["drive"] == "tmcm-1140"
    # Reads and the version alone; nothing that moves, sets or stores.
    assert set(module.commands) <= {6, 10, 15, 31, 135, 136, 138}, module.commands
    # The printed URL works when it is pasted.
    assert polepair("get", found[0]["url"], "actual position").stdout.strip()
    [head, row] = csv.reader(io.StringIO(polepair("scan", module.path, "--format", "csv", silence=True).stdout))
    assert dict(zip(head, row, strict=True))["url"] == found[0]["url"]


@pytest.mark.parametrize("drive", ["modbus-rtu:1", "tml:1"])
def test_each_serial_protocol_is_found(sim, drive):
    path = sim(drive)
    found = polepair("scan", path, "--format", "jsonl", silence=True).stdout.splitlines()
    protocol, address = drive.split(":")
    urls = [json.loads(line)["url"] for line in found]
    assert len(urls) == 1 and urls[0].startswith(f"{protocol}+serial://") and urls[0].endswith(f"#{address}"), urls


def test_a_search_is_broken_off_at_once():
    ours, theirs = pty.openpty()
    search = subprocess.Popen(
        [POLEPAIR, "scan", os.ttyname(theirs)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert select.select([ours], [], [], 60)[0], "it asks"
    begun = time.monotonic()
    search.send_signal(signal.SIGINT)
    _, said = search.communicate(timeout=60)
    assert search.returncode == 130, said
    assert time.monotonic() - begun < 30
    os.close(ours)
    os.close(theirs)


def test_the_doctor_tries_other_protocols(sim):
    path = sim("modbus-rtu:1")
    done = polepair("doctor", f"tmcl+serial://{path}", "--try-bauds", check=False, timeout=300, silence=True)
    assert f"modbus-rtu+serial://{path}" in done.stdout, done.stdout
