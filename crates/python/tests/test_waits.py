"""Time limits of the tests themselves."""

from __future__ import annotations

import subprocess
import sys

import polepair_test_support
import pytest
from polepair_test_support import first_line, wait_until


def test_the_first_accepted_value_is_returned() -> None:
    values = iter([1, 2, 3, 4])
    assert wait_until("a value over 2", lambda: next(values), lambda value: value > 2) == 3
    assert next(values) == 4


def test_a_failed_wait_shows_the_last_value_and_the_load(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(polepair_test_support, "MAX_WAIT", 0.05)
    expected = r"^waited \d+ s for: a speed of 5; seen: 3; load [\d.]+ [\d.]+ [\d.]+ on \d+ processors$"
    with pytest.raises(AssertionError, match=expected):
        wait_until("a speed of 5", lambda: 3, lambda speed: speed == 5)


def test_a_process_that_prints_nothing_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(polepair_test_support, "MAX_WAIT", 0.05)
    words = [sys.executable, "-c", "import time; time.sleep(600)"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        with pytest.raises(AssertionError, match="for: a line; seen: 'no output'"):
            first_line("a line", process)
        assert process.wait(120) == -9
