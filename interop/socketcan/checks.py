"""Helpers of the guest's checks: each check prints `ok NAME` or `failed NAME: why`."""

import os
import select
import subprocess
import time
import traceback

from polepair_test_support import MAX_WAIT

CHECKS = []


def check(function):
    CHECKS.append(function)
    return function


def run_all():
    """Every check, in the order of the file."""
    for function in CHECKS:
        try:
            function()
            print("ok", function.__name__, flush=True)
        except Exception:  # the host shows it
            why = traceback.format_exc().replace("\n", " | ")
            print(f"failed {function.__name__}: {why}", flush=True)


class Candump:
    """Log of candump without times, once it is known to receive every bus."""

    PROBE = "7E0#"

    def __init__(self, *buses):
        self.process = subprocess.Popen(["candump", "-L", *buses], stdout=subprocess.PIPE)
        self.text = b""
        wanted = [f"{bus} {self.PROBE}" for bus in buses]
        for _ in range(100):
            for bus in buses:
                run("cansend", bus, self.PROBE)
            # On each bus its own, and what comes through from the others.
            if all(self.heard(0.2).count(line) >= len(buses) for line in wanted):
                break
        self.heard(0.5)
        self.text = b""

    def heard(self, seconds):
        """Frames that were logged so far, read until the bus is silent for this time or five times that passed."""
        end = time.monotonic() + 5 * seconds
        while time.monotonic() < end and self.talks(seconds):
            self.text += os.read(self.process.stdout.fileno(), 65536)
        return [line.split(" ", 1)[1].strip() for line in self.text.decode().splitlines()]

    def talks(self, seconds):
        return select.select([self.process.stdout], [], [], seconds)[0]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()


def run(*words):
    done = subprocess.run(words, capture_output=True, text=True, timeout=MAX_WAIT, check=False)
    assert done.returncode == 0, (words, done.stdout, done.stderr)
    return done.stdout
