"""A port that pyserial opened is a link."""

from __future__ import annotations

import subprocess
from pathlib import Path

import polepair
import serial
from served import POLEPAIR


def test_a_port_of_pyserial_is_a_link(tmp_path: Path) -> None:
    path = str(tmp_path / "drive")
    simulator = subprocess.Popen(
        [POLEPAIR, "sim", "tmcl:3", "--pty", path], stdout=subprocess.PIPE, text=True
    )
    try:
        assert simulator.stdout is not None
        assert simulator.stdout.readline().startswith("ready ")
        with (
            serial.Serial(path) as port,
            polepair.connect(port, protocol="tmcl", axes=[3]) as link,
        ):
            axis = link.axis(3)
            assert axis.product == "tmcm-171"
            axis.params["max current"] = 1.5
            assert axis.params.raw["max current"] == 15
            assert axis.raw("GAP 6, 0") == 15
    finally:
        simulator.terminate()
        simulator.wait(timeout=120)
