"""TMCL modules as they are in the field: programs, twins, and modules that ignore their address."""

import json
import time

import pytest

from conftest import polepair
from odd_tmcl import Module, SerialLine, SlcanBus
from polepair_test_support import wait_until

MST, STOP_PROGRAM = 3, 128
VALUES = ("target position", "actual position", "target velocity", "actual velocity")


@pytest.fixture
def wires():
    made = []

    def wire(kind, *modules, **options):
        made.append(kind(*modules, **options))
        return made[-1]

    yield wire
    for one in made:
        one.close()


def opcodes(module):
    return [opcode for _, opcode, _, _, _ in module.requests]


@pytest.mark.parametrize("address", [1, 7])
@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("kind", [SerialLine, SlcanBus])
def test_a_stop_ends_the_program_that_would_turn_the_motor_again(wires, kind, named, address):
    module = Module(address, motors=2)
    wire = wires(kind, module)
    module.run_program(period=0.2)
    time.sleep(0.3)
    assert module.axes[0][3] == 1000
    stopped = polepair("stop", wire.url + (f"#{address}" if named else ""), silence=True)
    assert f"axis {address}: its program ran and was ended" in stopped.stderr, stopped
    said = opcodes(module)
    ended = said.index(STOP_PROGRAM)
    # The motor is stopped before the module is asked, and again when its program has ended.
    assert MST in said[:ended] and MST in said[ended:]
    time.sleep(0.6)
    assert module.axes[0][3] == 0 and not module.program


def test_a_program_can_be_kept(wires):
    module = Module()
    wire = wires(SerialLine, module)
    module.run_program(period=30)
    time.sleep(0.1)
    kept = polepair("stop", wire.url + "#1", "--keep-program")
    assert "were not ended" in kept.stderr and STOP_PROGRAM not in opcodes(module), kept
    assert module.program and module.axes[0][3] == 0


def test_a_program_that_does_not_run_is_not_ended(wires):
    module = Module()
    stopped = polepair("stop", wires(SerialLine, module).url + "#1")
    assert "program" not in stopped.stderr and STOP_PROGRAM not in opcodes(module), stopped


def test_a_module_that_still_reports_its_program_is_named(wires):
    module = Module()
    wire = wires(SerialLine, module)
    module.stays_running = True
    assert "still reports it as running" in polepair("stop", wire.url + "#1").stderr


def run_until(reports, exit_code, *words, after_each=lambda run: None):
    """Runs the command again until it ends and reports as expected.

    On a busy machine the reply of the second module can arrive after the host waited for it. The host
    then cannot see that two modules replied, or takes the reply for that to its next request."""

    def run():
        done = polepair(*words, check=False)
        after_each(done)
        return done

    expected = f"`{' '.join(words)}` ends with {exit_code} and reports as expected"
    wait_until(expected, run, lambda done: done.returncode == exit_code and reports(done))


@pytest.mark.parametrize("delay", [0.0, 0.0003, 0.002, 0.005, 0.017, 0.04])
def test_two_modules_with_one_address_are_reported_and_not_believed(wires, delay):
    twins = Module(5, position=100), Module(5, version=0x04D80322, position=200)
    wire = wires(SlcanBus, *twins, delay=delay)
    twice = "module 5 answers twice: two modules have this address"

    for words in (["get", wire.url + "#5", *VALUES], ["info", wire.url + "#5"], ["watch", wire.url + "#5", "--for", "1s"]):
        run_until(lambda run: "E502" in run.stderr and twice in run.stderr and run.stdout == "", 5, *words)
    # With a named product the first value shows the clash.
    named = ["get", wire.url + "?profile=tmcm-171#5", "actual position"]
    run_until(lambda run: twice in run.stderr and run.stdout == "", 5, *named)
    run_until(lambda run: twice in run.stdout and "E104" in run.stderr, 1, "scan", wire.url, "--ids", "5")
    run_until(lambda run: twice in run.stdout, 5, "doctor", wire.url + "#5")


def test_both_of_two_modules_with_one_address_are_stopped(wires):
    twins = Module(5), Module(5)
    wire = wires(SlcanBus, *twins, delay=0.003)

    def turn():
        for module in twins:
            module.axes[0][3] = 700

    def both_stopped(run):
        assert [module.axes[0][3] for module in twins] == [0, 0] and run.returncode != 0, run
        turn()

    turn()
    for url in (wire.url + "#5", wire.url):
        # The reply does not name the module, so the host cannot see whether both stand still.
        run_until(lambda run: "may still turn" in run.stderr, 5, "stop", url, after_each=both_stopped)


@pytest.mark.parametrize("delay", [0.0, 0.004])
def test_a_module_alone_is_believed(wires, delay):
    wire = wires(SlcanBus, Module(5, position=100), Module(6, position=200), delay=delay)
    for number, position in ((5, 100), (6, 200)):
        got = polepair("get", f"{wire.url}#{number}", "actual position")
        assert got.stdout.strip() == f"actual position = {position}", got
    assert "twice" not in polepair("scan", wire.url, "--ids", "5-6").stdout


@pytest.mark.parametrize("address", [1, 5, 30])
def test_a_module_that_ignores_its_address_is_one(wires, address):
    wire = wires(SerialLine, Module(address, position=4242), ignores_address=True)
    # An address that was not named is silent, and has the usual time-out.
    scanned = polepair("scan", wire.url, silence=True)
    rows = [line for line in scanned.stdout.splitlines() if line[:1].isdigit()]
    assert len(rows) == 1 and rows[0].startswith(f"{address} "), scanned
    assert f"axis {address}: replies to every address" in scanned.stdout, scanned
    few = f"{max(address - 3, 3)}-{address + 3}" if address > 2 else "1-5"
    found = polepair("scan", wire.url, "--ids", few, "--format", "jsonl", silence=True).stdout.splitlines()
    found = [json.loads(line) for line in found]
    assert [(one["axis"], one["clash"], one["ignores_address"]) for one in found] == [(address, False, True)]
    assert polepair("get", f"{wire.url}#{address}", "actual position").stdout.strip().endswith("= 4242")
    other = polepair("get", f"{wire.url}#9", "actual position", check=False, silence=True)
    assert other.returncode == 4 and f"the drive here has address {address}" in other.stderr, other
    assert "two drives" not in polepair("doctor", wire.url, check=False, silence=True).stdout


def scanned(url):
    lines = polepair("scan", url, "--ids", "1-3", "--format", "jsonl").stdout.splitlines()
    return [json.loads(line)["axis"] for line in lines]


@pytest.mark.parametrize("kind", [SerialLine, SlcanBus])
@pytest.mark.parametrize("motors", [1, 3, 6])
def test_each_motor_of_a_module_is_an_axis(wires, kind, motors):
    module = Module(motors=motors)
    url = wires(kind, module).url
    assert scanned(url) == [1, *[f"1.{n}" for n in range(1, motors)]]
    last = motors - 1
    for n, axis in enumerate(module.axes):
        axis[1] = 1000 * n
        axis[2] = axis[3] = 500
    read = polepair("get", f"{url}#1.0-{last}", "actual position").stdout
    assert read.split("\n")[last].endswith(f"actual position = {1000 * last}"), read
    module.requests.clear()
    stopped = polepair("stop", f"{url}#1")
    assert "axis 1 is stopped" in stopped.stdout + stopped.stderr, stopped
    assert [axis[3] for axis in module.axes] == [0] * motors
    refused = polepair("get", f"{url}#1.6", "actual position", check=False)
    assert refused.returncode == 2 and "E212" in refused.stderr, refused


def test_one_motor_is_stopped_alone(wires):
    module = Module(motors=3)
    url = wires(SerialLine, module).url
    for axis in module.axes:
        axis[2] = axis[3] = 500
    polepair("stop", f"{url}#1.1")
    assert [axis[3] for axis in module.axes] == [500, 0, 500]


def test_a_module_that_ignores_the_motor_has_one(wires):
    module = Module(motors=1, mirrors=True)
    url = wires(SerialLine, module).url
    assert scanned(url) == [1]
    assert "motors" not in polepair("scan", url, "--ids", "1-1").stdout


def test_a_known_module_without_its_scales_is_read_raw(wires):
    wire = wires(SerialLine, Module(version=0x04EC0130, position=100))
    assert "TMCM-1260 V1.48" in polepair("scan", f"{wire.url}", "--ids", "1-1").stdout
    got = polepair("get", f"{wire.url}#1", "actual position").stdout
    assert got.strip() == "actual position = 100"


@pytest.mark.parametrize("number, nearest", [(1239, "tmcm-1240"), (1655, "tmcm-1640"), (3229, "tmcm-3216"), (930, None)])
def test_a_module_that_nobody_knows_has_a_way_out(wires, number, nearest):
    module = Module(version=number << 16 | 0x0105)
    wire = wires(SerialLine, module)
    for verb, value, example in (
        ("spin", "60rpm", "ROR 0, 500"), ("move", "1turn", "MVP ABS, 0, 1000"), ("home", None, "RFS START, 0")
    ):
        refused = polepair(verb, f"{wire.url}#1", *([value] if value else []), check=False)
        assert refused.returncode == 2 and "E218" in refused.stderr, refused
        assert f'polepair send URL "{example}" --arm' in refused.stderr, refused.stderr
        assert (f"?profile={nearest}" if nearest else "select the drive by `?profile=`") in refused.stderr, refused.stderr
    # Both ways work.
    polepair("send", f"{wire.url}#1", "ROR 0, 500; GAP 3, 0", "--arm")
    assert module.requests[-1][1] == 6 and any(opcode == 1 for opcode in opcodes(module))
