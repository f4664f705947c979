"""Trinamic's own Python client, and its examples as they are, against our stepper modules."""

import pathlib
import runpy
import sys
import tarfile
import time

import pytest
from conftest import end, polepair, start
from polepair_test_support import wait_until
from pytrinamic.connections import ConnectionManager
from pytrinamic.modules import TMCM6110
from pytrinamic.tmcl import TMCLCommand

SPEED = 1500
# Factor by which motors and examples run faster than in reality.
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

    def with_url(drive):
        port = served(drive)
        manager = ConnectionManager(f"--interface serial_tmcl --port {port} --data-rate 115200 --timeout 30")
        interfaces.append(manager.connect())
        return interfaces[-1], f"tmcl+serial://{port}"

    def connect(drive):
        return with_url(drive)[0]

    connect.with_url = with_url
    yield connect
    for interface in interfaces:
        interface.close()


def wait_for_velocity(motor, velocity):
    wait_until(f"the velocity is {velocity}", lambda: motor.actual_velocity, lambda now: now == velocity)


def test_six_motors_turn_and_move_each_for_itself(connect):
    module = TMCM6110(connect("tmcm-6110"))
    for n, motor in enumerate(module.motors):
        motor.linear_ramp.max_acceleration = 1000
        motor.rotate(SPEED if n % 2 else -SPEED)
    for n, motor in enumerate(module.motors):
        wanted = SPEED if n % 2 else -SPEED
        wait_for_velocity(motor, wanted)
        motor.stop()
        wait_for_velocity(motor, 0)
    for n, motor in enumerate(module.motors):
        motor.actual_position = 0
        motor.linear_ramp.max_velocity = 2000
        motor.move_to(2000 * (n - 3))
    for n, motor in enumerate(module.motors):
        wait_until(f"motor {n} reports its position as reached", motor.get_position_reached)
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


def test_stallguard_stops_the_motor_that_is_held(connect):
    interface, url = connect.with_url("tmcm-6110")
    module = TMCM6110(interface)
    held, free = module.motors[3], module.motors[1]
    for motor in held, free:
        motor.linear_ramp.max_acceleration = 2000
        motor.stallguard2.set_stop_velocity(500)
        motor.rotate(SPEED)
        wait_for_velocity(motor, SPEED)
    assert held.stallguard2.get_load_value() > 100
    polepair("act", f"{url}#1.3", "jam")
    wait_for_velocity(held, 0)
    assert held.get_axis_parameter(held.AP.ExtendedErrorFlags) & 1
    assert free.actual_velocity == SPEED


def test_a_program_that_one_host_stores_the_other_reads_and_runs(connect, tmp_path):
    interface, url = connect.with_url("tmcm-6110")
    motor = TMCM6110(interface).motors[0]
    instructions = [
        (TMCLCommand.SAP, motor.AP.MaxAcceleration, 0, 2000),
        (TMCLCommand.ROR, 0, 0, 500),
        (TMCLCommand.WAIT, 0, 0, 20),
        (TMCLCommand.ROL, 0, 0, 500),
        (TMCLCommand.WAIT, 0, 0, 20),
        (TMCLCommand.JA, 0, 0, 1),
    ]
    interface.send(TMCLCommand.START_DOWNLOAD_MODE, 0, 0, 0)
    for instruction in instructions:
        interface.send(*instruction)
    interface.send(TMCLCommand.QUIT_DOWNLOAD_MODE, 0, 0, 0)
    text = tmp_path / "stored.tmc"
    polepair("program", "save", f"{url}#1", str(text))
    lines = [line.split("//")[0].strip() for line in text.read_text().splitlines()]
    assert lines == [
        "SAP 5, 0, 2000", "L1:", "ROR 0, 500", "WAIT TICKS, 0, 20", "ROL 0, 500", "WAIT TICKS, 0, 20", "JA L1",
    ]
    polepair("program", "run", f"{url}#1", "L1", "--source", str(text), "--detach")
    wait_for_velocity(motor, 500)
    wait_for_velocity(motor, -500)
    interface.send(TMCLCommand.STOP_APPLICATION, 0, 0, 0)
    motor.stop()
    wait_for_velocity(motor, 0)
    text.write_text("// by the other host\nLoop: SGP 7, 2, 42\nSTOP\n")
    polepair("program", "load", f"{url}#1", str(text))
    interface.send(TMCLCommand.RUN_APPLICATION, 1, 0, 0)
    wait_until("the program sets GP 7", lambda: interface.get_global_parameter(7, 2), lambda value: value == 42)
    assert interface.send(TMCLCommand.READ_TMCL_MEMORY, 0, 0, 0).value == 42
