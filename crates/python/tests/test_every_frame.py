"""Every verb, every frame: at the n-th frame the wire is cut, silent, away for a moment, or loses it.

A witness that asks the drive itself says what became of the motor. `POLEPAIR_FRAMES=all` tries every
frame of each verb; otherwise one is tried.
"""

from __future__ import annotations

import os
import random
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass

import polepair
import pytest
from polepair_test_support import MAX_WAIT
from served import POLEPAIR

ALL = os.environ.get("POLEPAIR_FRAMES") == "all"
SOME = 1
AT_ONCE = 4
TURNS = 6.0
"""Commanded speed, rad/s."""
STANDS = 0.5
"""A slower motor is at standstill, rad/s."""
AWAY = 0.8
"""Duration of a short interruption of the wire, s."""
MOVED = 1.0
"""Commanded travel, rad."""


def spin(axis: polepair.Axis) -> None:
    with axis.armed():
        axis.spin(TURNS)
        time.sleep(0.3)


def move(axis: polepair.Axis) -> None:
    with axis.armed():
        axis.move_by(MOVED).wait(20)


def stop(axis: polepair.Axis) -> None:
    axis.stop()


def disable(axis: polepair.Axis) -> None:
    axis.disable()


Verb = Callable[[polepair.Axis], None]
ENDING: tuple[Verb, ...] = (stop, disable)
FAMILIES: dict[str, tuple[Verb, ...]] = {
    "tmcl:1": (spin, move, stop, disable),
    "tml:1": (spin, move, stop, disable),
    "modbus-rtu:1": (spin, stop, disable),
    "tmlcan:1": (spin, stop),
}
FAULTS = ("cut", "silent", "away", "lost")


class Drive:
    """A simulated drive in a process of its own, on TCP."""

    def __init__(self, word: str) -> None:
        self.child = subprocess.Popen(
            [str(POLEPAIR), "sim", word, "--tcp", "127.0.0.1:0"], stdout=subprocess.PIPE, text=True
        )
        assert self.child.stdout is not None
        self.url = self.child.stdout.readline().split()[1]
        self.ends = False

    def run(self, *words: str) -> None:
        verb, *rest = words
        subprocess.run([str(POLEPAIR), verb, self.url, *rest], check=True, capture_output=True)

    def read(self, signal: str) -> float:
        """Value of the drive itself. Its line may still be busy with the client that was cut off."""
        end = time.monotonic() + MAX_WAIT
        while True:
            try:
                with polepair.connect(self.url) as link:
                    return float(link.axes[0].read(signal)[signal])
            except polepair.NoReply:
                if time.monotonic() > end:
                    raise

    def close(self) -> None:
        self.child.kill()
        self.child.wait()


class Wire:
    """The wire between the program and the drive: it counts frames, and fails at one of them."""

    def __init__(self, url: str, fault: str, at: int | None) -> None:
        scheme, rest = url.split("://")
        address, self.axes = rest.split("#")
        host, port = address.split(":")
        self.drive = (host, int(port))
        self.server = socket.create_server(("127.0.0.1", 0))
        own = self.server.getsockname()
        self.url = f"{scheme}://{own[0]}:{own[1]}#{self.axes}"
        self.fault, self.at = fault, at
        self.passed = 0
        self.failed: float | None = None
        self.lock = threading.Lock()
        self.open: list[socket.socket] = []
        threading.Thread(target=self.accept, daemon=True).start()

    def accept(self) -> None:
        while True:
            try:
                near, _ = self.server.accept()
                far = socket.create_connection(self.drive)
            except OSError:
                return
            self.open += [near, far]
            for ends in ((near, far), (far, near)):
                threading.Thread(target=self.carry, args=ends, daemon=True).start()

    def passes(self) -> bool:
        """Returns whether the next frame gets through."""
        with self.lock:
            self.passed += 1
            if self.failed is None and self.passed == self.at:
                self.failed = time.monotonic()
            if self.failed is None:
                return True
            if self.fault == "lost":
                return self.passed != self.at
            return self.fault == "away" and time.monotonic() > self.failed + AWAY

    def carry(self, near: socket.socket, far: socket.socket) -> None:
        with suppress(OSError):
            while data := near.recv(4096):
                if self.passes():
                    far.sendall(data)
                elif self.fault == "cut":
                    self.close()
        for end in (near, far):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        for end in (self.server, *self.open):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()


@dataclass
class Seen:
    """Result of a verb, and the state of the motor after it."""

    error: polepair.PolepairError | None
    connected: bool
    failed: bool
    before: float
    position: float
    velocity: float
    frames: int

    def __str__(self) -> str:
        code = None if self.error is None else (self.error.code, self.error.executed)
        return f"{code} {self.error}: {self.position - self.before:.2f} rad, {self.velocity:.2f} rad/s"


def tried(word: str, verb: Verb, fault: str, at: int | None) -> Seen:
    drive = Drive(word)
    try:
        if word.startswith("modbus"):
            drive.run("set", "control mode=1")
        if verb in ENDING:
            drive.run("spin", f"{TURNS}rad/s", "--detach")
            while drive.read("velocity") < TURNS / 2:
                pass
        before = drive.read("position")
        wire = Wire(drive.url, fault, at)
        error, connected = None, False
        try:
            with polepair.connect(wire.url) as link:
                connected = True
                verb(link.axes[0])
        except polepair.PolepairError as raised:
            error = raised
        wire.close()
        # The motor needs some time to brake.
        end = time.monotonic() + 2.0
        while abs(velocity := drive.read("velocity")) > STANDS and time.monotonic() < end:
            pass
        position = drive.read("position")
        failed = wire.failed is not None
        return Seen(error, connected, failed, before, position, velocity, wire.passed)
    finally:
        drive.close()


def wrong(verb: Verb, fault: str, seen: Seen) -> str | None:
    """Returns a wrong claim, or that the motor turns on though it could be stopped."""
    stands = abs(seen.velocity) < STANDS
    if seen.error is None:
        if not stands:
            return "it is done, and the motor turns"
        if verb is move and abs(seen.position - seen.before - MOVED) > 0.1:
            return "it is done, and is not there"
        return None
    if not seen.failed:
        return "nothing was wrong with the wire"
    if seen.error.executed is True:
        return "what failed is told as executed"
    if not seen.connected:
        moved = abs(seen.position - seen.before) > 0.1
        return "it was moved by who never got there" if moved and verb not in ENDING else None
    if verb in ENDING:
        if seen.error.executed is False and stands:
            return "told as not executed, and it was"
        return None
    if fault in ("away", "lost") and not stands:
        return "the wire came back, and the motor turns"
    return None


@pytest.mark.parametrize("word", FAMILIES)
def test_the_result_of_a_verb_is_what_the_drive_did(word: str) -> None:
    chance = random.Random(word)
    with ThreadPoolExecutor(AT_ONCE) as pool:
        sound = {verb: pool.submit(tried, word, verb, "cut", None) for verb in FAMILIES[word]}
        cases = []
        for verb, result in sound.items():
            seen = result.result()
            assert seen.error is None and wrong(verb, "cut", seen) is None, f"{verb.__name__}: {seen}"
            frames = range(1, seen.frames + 1)
            for fault in FAULTS:
                for at in frames if ALL else sorted(chance.sample(frames, SOME)):
                    cases.append((verb, fault, at, pool.submit(tried, word, verb, fault, at)))
        found = []
        for verb, fault, at, case in cases:
            try:
                seen = case.result()
            except polepair.NoReply as error:
                found.append(f"{verb.__name__}, {fault} at frame {at}: {error}")
                continue
            if what := wrong(verb, fault, seen):
                found.append(f"{verb.__name__}, {fault} at frame {at}: {what}: {seen}")
    assert not found, "\n".join(found)
    assert len(cases) >= SOME * len(FAULTS) * len(FAMILIES[word])
