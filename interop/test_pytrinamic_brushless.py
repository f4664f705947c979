"""Trinamic's own Python client, with its examples as they are, against our brushless and servo modules."""

import re
import runpy
import time

import pytest
import pytrinamic.connections
from conftest import polepair
from pytrinamic.connections import ConnectionManager
from test_pytrinamic_steppers import HURRY, examples, served  # noqa: F401

EXAMPLES = [
    "TMCM1617/TMCL/encoder_position_mode",
    "TMCM1617/TMCL/hall_position_mode",
    "TMCM1630/TMCL/encoder_position_mode",
    "TMCM1630/TMCL/hall_position_mode",
    "TMCM1633/TMCL/encoder_position_mode",
    "TMCM1633/TMCL/hall_position_mode",
    "TMCM1636/TMCL/encoder_position_mode",
    "TMCM1636/TMCL/encoder_velocity_mode",
    "TMCM1636/TMCL/hall_position_mode",
    "TMCM1637/TMCL/encoder_position_mode",
    "TMCM1637/TMCL/hall_position_mode",
    "TMCM1638/TMCL/encoder_position_mode",
    "TMCM1638/TMCL/hall_position_mode",
    "TMCM1640/TMCL/encoder_position_mode",
    "TMCM1640/TMCL/hall_position_mode",
    "TMCM1670/TMCL/position_mode",
    "TMCM1690/TMCL/abn_encoder_position_mode",
    "TMCM1690/TMCL/abn_encoder_velocity_mode",
    "TMCM1690/TMCL/hall_position_mode",
    "TMCM1690/TMCL/hall_velocity_mode",
    "TMCM2611/copy_axis_0_settings_to_axis_1",
    "TMCM2611/encoder_velocity_mode",
    "TMCM2611/hall_velocity_mode",
    "TMCM2611/print_settings",
]


@pytest.mark.parametrize("example", EXAMPLES)
def test_the_makers_example_runs_as_it_is(served, examples, monkeypatch, capsys, example):  # noqa: F811
    drive = f"tmcm-{example[4:8]}"
    port = served(drive, "--speed", str(HURRY))
    arguments = f"--interface serial_tmcl --port {port} --data-rate 115200"

    class Connected(ConnectionManager):
        """The port of this test in place of the one that the example names."""

        def __init__(self, *_, **__):
            super().__init__(arguments)

    monkeypatch.setattr(pytrinamic.connections, "ConnectionManager", Connected)
    sleep = time.sleep
    monkeypatch.setattr(time, "sleep", lambda seconds: sleep(seconds / HURRY))
    runpy.run_path(str(examples / f"{example}.py"))
    printed = capsys.readouterr().out
    url = f"tmcl+serial://{port}"
    if "position_mode" in example:
        # Each ends where it began, after many turns.
        assert abs(raw(url, "actual position")) <= 10, printed[-300:]
        targets = {int(number) for number in re.findall(r"target position: (-?\d+)", printed)}
        assert max(targets) >= 1000, printed[-300:]
    elif "velocity_mode" in example:
        assert abs(raw(url, "actual velocity")) <= 10, printed[-300:]


def raw(url, name):
    """A parameter, read by our own host."""
    return int(polepair("get", url, name, "--raw").stdout.split("=")[1])
