"""The profiles of docs/examples for drives of other makers, each against a motor that follows its maker's manual."""

import termios
from pathlib import Path

import pytest
from conftest import end, occurs_within, polepair, start
from modbus_motors import Az, Ihsv57, Servo42d, Station, VfdEl, Zlac8015d
from pymodbus.client import ModbusSerialClient

EXAMPLES = Path(__file__).resolve().parents[1] / "docs" / "examples"


class Bench:
    def __init__(self, name, drive):
        self.station = Station(drive)
        self.file = str(EXAMPLES / f"{name}.toml")
        self.url = f"modbus-rtu+serial://{self.station.path}?profile={name}&timeout=3000#1"

    def run(self, verb, *words, check=True):
        return polepair(verb, "--profile", self.file, self.url, *words, check=check)


POSITIONERS = [("mks-servo42d", Servo42d), ("oriental-az", Az)]
DRIVES = [*POSITIONERS, ("delta-vfd-el", VfdEl)]


def pytest_generate_tests(metafunc):
    if "bench" in metafunc.fixturenames:
        drives = POSITIONERS if "move" in metafunc.function.__name__ or "arrives" in metafunc.function.__name__ else DRIVES
        metafunc.parametrize("bench", drives, indirect=True, ids=[name for name, _ in drives])


@pytest.fixture
def bench(request):
    name, drive = request.param
    bench = Bench(name, drive())
    yield bench
    bench.station.close()


def test_it_turns_both_ways(bench):
    for speed in ("120rpm", "-120rpm"):
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
    motor = bench.station.drive.motor
    bench.run("spin", "--detach", "100rpm")
    # Speeds are whole steps a second, or hundredths of a hertz.
    assert abs(motor.wanted - 100) < 0.2
    stopped = bench.run("stop")
    assert "axis 1 is stopped" in stopped.stderr, stopped.stderr
    assert motor.speed == 0


def test_info_shows_what_turns(bench):
    rows = lambda: dict(line.split(None, 1) for line in bench.run("info").stdout.splitlines()[1:] if line.split(None, 1)[1:])
    assert rows()["velocity"] == "0 rpm"
    bench.run("spin", "--detach", "60rpm")
    turning = rows()
    assert turning["velocity"] != "0 rpm", turning
    if "moving" in turning:
        assert turning["moving"] == "yes", turning
    bench.run("stop")


def test_a_fault_is_named_and_cleared(bench):
    drive = bench.station.drive
    if isinstance(drive, Servo42d):
        drive.protected = 1
    elif isinstance(drive, Az):
        drive.words[0x81] = 0x30
    else:
        drive.error = 5
    refused = bench.run("spin", "--for", "1s", "60rpm", check=False)
    assert refused.returncode != 0 and drive.motor.speed == 0, refused.stdout
    assert "the drive reports" in refused.stderr, refused.stderr
    bench.run("clear")
    bench.run("spin", "--for", "1s", "60rpm")


@pytest.mark.parametrize(
    ("name", "drive", "rate"),
    [
        ("mks-servo42d", Servo42d, termios.B38400),
        ("oriental-az", Az, termios.B115200),
        ("delta-vfd-el", VfdEl, termios.B9600),
    ],
)
def test_the_port_is_set_as_the_profile_states(name, drive, rate):
    bench = Bench(name, drive())
    bench.run("info")
    assert termios.tcgetattr(bench.station.other_end)[5] == rate
    bench.station.close()


def test_a_move_without_the_speed_that_its_request_carries_names_it(bench):
    motor = bench.station.drive.motor
    refused = bench.run("move", "1turn", check=False)
    assert refused.returncode == 2 and "--vel" in refused.stderr, refused.stderr
    assert "Nothing was sent" in refused.stderr and motor.target is None


def test_a_motion_is_one_request():
    bench = Bench("mks-servo42d", Servo42d())
    bench.run("move", "-1turn", "--vel", "60rpm")
    assert (0xF5, [200, 60, 0xFFFF, 0xC000]) in bench.station.requests, bench.station.requests
    bench.station.close()


def test_a_stop_that_does_not_end_a_move_is_followed_by_the_emergency_stop():
    bench = Bench("mks-servo42d", Servo42d())
    bench.run("move", "100turn", "--vel", "60rpm", "--detach")
    stopped = bench.run("stop")
    assert "axis 1 is stopped" in stopped.stderr, stopped.stderr
    assert bench.station.drive.motor.speed == 0
    assert (0xF7, [1]) in bench.station.requests, bench.station.requests
    bench.station.close()


def test_a_reversal_shows_the_direction_that_the_motor_has():
    bench = Bench("delta-vfd-el", VfdEl())
    bench.run("spin", "--detach", "300rpm")
    bench.run("spin", "--detach", "-300rpm")
    seen = [bench.run("get", "output frequency").stdout for _ in range(3)]
    motor = bench.station.drive.motor
    motor.speed = -120.0
    motor.wanted = -120.0
    assert "= -120 rpm" in bench.run("get", "output frequency").stdout, seen
    motor.wanted, motor.speed = 120.0, 120.0
    assert "= 120 rpm" in bench.run("get", "output frequency").stdout
    bench.run("stop")
    bench.station.close()


@pytest.fixture
def started():
    running = []

    def sim(*words):
        process, url = start(*words)
        running.append(process)
        return url

    yield sim
    for process in running:
        end(process)


@pytest.mark.parametrize("name", ["mks-servo42d", "oriental-az", "delta-vfd-el"])
def test_the_simulated_drive_of_a_profile_obeys_it(name, started, tmp_path):
    file, port = str(EXAMPLES / f"{name}.toml"), tmp_path / "port"
    url = started("--profile", file, "--pty", str(port))
    assert url == f"modbus-rtu+serial://{port}?profile={name}#1"
    run = lambda verb, *words: polepair(verb, "--profile", file, url, *words).stdout
    for speed in ("120rpm", "-120rpm"):
        assert f"velocity reached = {speed.replace('rpm', ' rpm')}" in run("spin", "--for", "2s", speed)
    if name != "delta-vfd-el":
        assert "position = 1.5 turn" in run("move", "1.5turn", "--vel", "120rpm")
        assert "position = 1 turn" in run("move", "-0.5turn", "--rel", "--vel", "120rpm")
    run("spin", "--detach", "60rpm")
    run("stop")


def test_another_client_turns_the_simulated_drive_of_a_profile(started, tmp_path):
    port = tmp_path / "port"
    started("--profile", str(EXAMPLES / "delta-vfd-el.toml"), "delta-vfd-el:7", "--pty", str(port))
    client = ModbusSerialClient(str(port), baudrate=9600, timeout=10, retries=0)
    assert client.connect()
    read = lambda address: client.read_holding_registers(address, count=1, device_id=7)
    write = lambda address, value: client.write_register(address, value, device_id=7)
    write(0x2001, 1000)
    assert read(0x2103).registers == [0]
    write(0x2000, 0x22)
    # 10 Hz, backwards.
    assert occurs_within(20, lambda: read(0x2103).registers == [1000])
    assert read(0x2101).registers[0] & 0x18 == 0x08
    # A frequency that is written while it turns counts at once, as in the inverter.
    write(0x2001, 500)
    assert occurs_within(20, lambda: read(0x2103).registers == [500])
    write(0x2000, 1)
    assert occurs_within(20, lambda: read(0x2103).registers == [0])
    assert read(0x2200).exception_code == 2
    assert write(0x2001, 6000).exception_code == 3
    assert write(0x2103, 1).exception_code == 2
    client.close()


def test_own_profiles_stand_in_racks_and_connection_strings(tmp_path):
    rack = tmp_path / "cell.toml"
    file = EXAMPLES / "delta-vfd-el.toml"
    rack.write_text(
        f"[[link]]\nname = 'line'\n[[link.drive]]\nname = 'fan'\nprofile = '{file}'\naddress = 3\n"
    )
    for url in (f"sim:{rack}#fan", f"sim:{file}:4#4", f"sim:{file}#1"):
        turned = polepair("spin", url, "--for", "2s", "-120rpm")
        assert "velocity reached = -120 rpm" in turned.stdout, turned.stdout + turned.stderr
    # A profile that extends a simulated one is simulated as that is.
    for base, address in [("tmcm-171", 3), ("cia402", 5)]:
        own = tmp_path / "own.toml"
        own.write_text(f"name = 'own-{base}'\nextends = '{base}'\ntitle = 'Own'\n")
        assert f"own-{base}" in polepair("info", f"sim:{own}:{address}#{address}").stdout
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(file.read_text().replace("scale = 0.3", "scael = 0.3"))
    refused = polepair("info", f"sim:{wrong}:1#1", check=False)
    assert "did you mean `scale`?" in refused.stderr, refused.stderr


@pytest.fixture(params=["fake", "simulated"])
def two_motors(request, started, tmp_path):
    """A function that runs a verb on motors of a ZLAC8015D, by the maker's description or by the profile."""
    file, station = str(EXAMPLES / "zlac8015d.toml"), None
    if request.param == "fake":
        station = Station(Zlac8015d())
        port = station.path
    else:
        port = tmp_path / "port"
        assert started("--profile", file, "--pty", str(port)).endswith("?profile=zlac8015d#1")
    url = f"modbus-rtu+serial://{port}?profile=zlac8015d&timeout=3000"

    def run(verb, axes, *words, check=True):
        return polepair(verb, "--profile", file, f"{url}#{axes}", *words, check=check)

    yield run
    if station:
        station.close()


def speeds(two_motors):
    shown = two_motors("get", "1,1.2", "actual speed").stdout
    return [float(line.split("=")[1].split()[0]) for line in shown.splitlines()]


def test_two_motors_behind_one_address_turn_alone_and_together(two_motors):
    both = two_motors("spin", "1,1.2", "--for", "2s", "60rpm").stdout
    assert both.count("velocity reached = 60 rpm") == 2, both
    two_motors("spin", "1.2", "--detach", "-60rpm")
    assert occurs_within(20, lambda: abs(speeds(two_motors)[1] + 60) < 1)
    assert speeds(two_motors)[0] == 0
    # The left motor's move needs another mode, so its speed is taken while the right one turns.
    two_motors("spin", "1", "--detach", "30rpm")
    assert occurs_within(20, lambda: all(abs(a - b) < 1 for a, b in zip(speeds(two_motors), (30, -60))))
    two_motors("stop", "1.2")
    assert occurs_within(20, lambda: all(abs(a - b) < 1 for a, b in zip(speeds(two_motors), (30, 0))))
    two_motors("stop", "1")
    assert speeds(two_motors) == [0, 0]


def test_two_motors_behind_one_address_have_their_own_targets(two_motors):
    two_motors("move", "1", "1turn", "--vel", "120rpm")
    two_motors("move", "1.2", "-0.5turn", "--vel", "120rpm")
    shown = two_motors("get", "1,1.2", "actual position").stdout.splitlines()
    positions = [float(line.split("=")[1].split()[0]) for line in shown]
    assert all(abs(a - b) < 0.01 for a, b in zip(positions, (1, -0.5))), positions
    assert two_motors("info", "1.3", check=False).returncode == 2


def test_a_drive_that_moves_by_pulses_is_read_and_set():
    drive = Ihsv57()
    bench = Bench("ihsv57", drive)
    try:
        shown = bench.run("get", "position", "torque", "position error", "reverse torque limit").stdout
        assert [line.split("=")[1].strip() for line in shown.splitlines()] == ["-70010", "-11", "10", "-300"], shown
        bench.run("set", "rigidity=20")
        assert drive.written == {103: 20}
        refused = bench.run("spin", "60rpm", check=False)
        assert refused.returncode == 2 and drive.written == {103: 20}, refused.stderr
        assert "cut its enable input" in " ".join(bench.run("info").stdout.split())
    finally:
        bench.station.close()
