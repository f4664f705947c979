"""The profiles of docs/examples for drives of other makers, each against a motor that follows its maker's manual."""

import termios
from pathlib import Path

import pytest
from conftest import polepair
from modbus_motors import Az, Servo42d, Station

EXAMPLES = Path(__file__).resolve().parents[1] / "docs" / "examples"


class Bench:
    def __init__(self, name, drive):
        self.station = Station(drive)
        self.file = str(EXAMPLES / f"{name}.toml")
        self.url = f"modbus-rtu+serial://{self.station.path}?profile={name}&timeout=3000#1"

    def run(self, verb, *words, check=True):
        return polepair(verb, "--profile", self.file, self.url, *words, check=check)


@pytest.fixture(params=[("mks-servo42d", Servo42d), ("oriental-az", Az)], ids=lambda param: param[0])
def bench(request):
    name, drive = request.param
    bench = Bench(name, drive())
    yield bench
    bench.station.close()


def test_it_turns_both_ways(bench):
    for speed in ("100rpm", "-100rpm"):
        turned = bench.run("spin", "--for", "2s", speed)
        assert f"velocity reached = {speed.replace('rpm', ' rpm')}" in turned.stdout, turned.stdout + turned.stderr
    assert bench.station.drive.motor.speed == 0


def test_it_arrives_where_it_was_sent(bench):
    motor = bench.station.drive.motor
    for words, end in [(["1.5turn"], 1.5), (["-0.5turn", "--rel"], 1.0), (["-1turn"], -1.0)]:
        moved = bench.run("move", *words, "--vel", "120rpm")
        assert "position = " in moved.stdout, moved.stdout + moved.stderr
        assert abs(motor.position - end) < 0.001, motor.position


def test_a_stop_is_seen(bench):
    bench.run("spin", "--detach", "100rpm")
    # Speeds of the AZ are whole steps a second.
    assert abs(bench.station.drive.motor.speed - 100) < 0.1
    stopped = bench.run("stop")
    assert "axis 1 is stopped" in stopped.stderr, stopped.stderr
    assert bench.station.drive.motor.speed == 0


@pytest.mark.parametrize(
    ("name", "drive", "rate"),
    [("mks-servo42d", Servo42d, termios.B38400), ("oriental-az", Az, termios.B115200)],
)
def test_the_port_is_set_as_the_profile_states(name, drive, rate):
    bench = Bench(name, drive())
    bench.run("info")
    assert termios.tcgetattr(bench.station.other_end)[5] == rate
    bench.station.close()


def test_a_motion_is_one_request():
    bench = Bench("mks-servo42d", Servo42d())
    bench.run("move", "-1turn", "--vel", "60rpm")
    assert (0xF5, [200, 60, 0xFFFF, 0xC000]) in bench.station.requests, bench.station.requests
    bench.station.close()
