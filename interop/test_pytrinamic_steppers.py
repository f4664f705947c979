"""Trinamic's own Python client, and its examples as they are, against our stepper modules."""

import pathlib
import runpy
import sys
import tarfile
import time

import pytest
from conftest import end, start, until
from pytrinamic.connections import ConnectionManager
from pytrinamic.modules import TMCM1140, TMCM6110

SPEED = 1500
# How many times faster motors and examples live than they would at the desk.
HURRY = 10
SOURCES = pathlib.Path(sys.prefix) / "sources"


@pytest.fixture(scope="session")
def examples(tmp_path_factory):
    """The folder of the maker's examples."""
    folder = tmp_path_factory.mktemp("pytrinamic")
    (archive,) = SOURCES.glob("pytrinamic-*.tar.gz")
    with tarfile.open(archive) as sources:
        sources.extractall(folder, filter="data")
    return next(folder.iterdir()) / "examples" / "modules"


@pytest.fixture
def served(tmp_path):
    """A function that starts a module on a pty and gives the path that a client opens."""
    running = []

    def serve(drive, *options):
        path = tmp_path / f"pty{len(running)}"
        process, _ = start(f"{drive}:1", "--pty", str(path), *options)
        running.append(process)
        return str(path)

    yield serve
    for process in running:
        end(process)


@pytest.fixture
def connect(served):
    interfaces = []

    def connect(drive):
        port = served(drive)
        manager = ConnectionManager(f"--interface serial_tmcl --port {port} --data-rate 115200 --timeout 30")
        interfaces.append(manager.connect())
        return interfaces[-1]

    yield connect
    for interface in interfaces:
        interface.close()


def test_six_motors_turn_and_move_each_for_itself(connect):
    module = TMCM6110(connect("tmcm-6110"))
    for n, motor in enumerate(module.motors):
        motor.linear_ramp.max_acceleration = 1000
        motor.rotate(SPEED if n % 2 else -SPEED)
    for n, motor in enumerate(module.motors):
        wanted = SPEED if n % 2 else -SPEED
        assert until(lambda motor=motor, wanted=wanted: motor.actual_velocity == wanted)
        motor.stop()
        assert until(lambda motor=motor: motor.actual_velocity == 0)
    for n, motor in enumerate(module.motors):
        motor.actual_position = 0
        motor.linear_ramp.max_velocity = 2000
        motor.move_to(2000 * (n - 3))
    for n, motor in enumerate(module.motors):
        assert until(lambda motor=motor: motor.get_position_reached())
        assert motor.actual_position == 2000 * (n - 3)


def test_the_settings_of_the_client_are_the_modules(connect):
    motor = TMCM6110(connect("tmcm-6110")).motors[4]
    settings = motor.drive_settings
    settings.max_current, settings.standby_current = 200, 16
    settings.microstep_resolution = motor.ENUM.microstep_resolution_16_microsteps
    assert (settings.max_current, settings.standby_current, settings.microstep_resolution) == (200, 16, 4)
    motor.stallguard2.set_threshold(-5)
    assert motor.stallguard2.get_threshold() == -5
    motor.coolstep.set_threshold_speed(300)
    assert motor.coolstep.get_threshold_speed() == 300


@pytest.mark.parametrize("module, drive", [("TMCM6110", "tmcm-6110"), ("TMCM1140", "tmcm-1140")])
def test_the_makers_example_runs_as_it_is(served, examples, monkeypatch, capsys, module, drive):
    port = served(drive, "--speed", str(HURRY))
    arguments = ["--interface", "serial_tmcl", "--port", port, "--data-rate", "115200"]
    monkeypatch.setattr(sys, "argv", ["rotate_demo.py", *arguments])
    sleep = time.sleep
    monkeypatch.setattr(time, "sleep", lambda seconds: sleep(seconds / HURRY))
    runpy.run_path(str(examples / module / "TMCL" / "rotate_demo.py"))
    printed = capsys.readouterr().out.lower()
    assert "reached position 0" in printed and printed.strip().endswith("ready."), printed[-300:]


def test_stallguard_stops_a_motor_that_is_held(connect):
    interface = connect("tmcm-1140")
    motor = TMCM1140(interface).motors[0]
    motor.linear_ramp.max_acceleration = 2000
    motor.rotate(SPEED)
    assert until(lambda: motor.actual_velocity == SPEED)
    motor.stallguard2.set_stop_velocity(500)
    assert motor.stallguard2.get_load_value() > 100
    time.sleep(0.2)
    assert motor.actual_velocity == SPEED
