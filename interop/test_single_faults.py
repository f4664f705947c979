"""One serial fault, and what each client makes of it.

Sixty reads of six values from a drive that misbehaves once. A wrong value returned as good is the
worst that can happen; ours must return none, fail at most once a fault, and recover by itself.
The other clients are measured beside it and printed, not judged (pytest -s shows the table).
"""

import random
import subprocess
import time

import minimalmodbus
import pytest
from conftest import EXAMPLES, compiled
from faulty_drive import FAULTS, TIMEOUT, FaultyDrive, Rtu, Tmcl
from pymodbus.client import ModbusSerialClient
from pytrinamic.connections import SerialTmclInterface

READ_MANY = EXAMPLES / "read_many"
NUMBERS = [1, 4, 5, 7, 9, 11]
READS = 60
URLS = {
    Tmcl: f"tmcl+serial://{{}}?timeout={int(1000 * TIMEOUT)}&profile=tmcl#1",
    Rtu: f"modbus-rtu+serial://{{}}?timeout={int(1000 * TIMEOUT)}&gap=0&profile=modbus#1",
}
READ = {Tmcl: ("GAP {}", "1000"), Rtu: ("read {}", "1")}
WRITE = {Tmcl: "SAP 4, 0, 7", Rtu: "write 0x0004 7"}


def ours(drive, text=None, many=READS):
    template, factor = READ[drive.protocol]
    words = [READ_MANY, URLS[drive.protocol].format(drive.path), text or template, factor, str(many)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    _, right, _, wrong, _, failed = done.stdout.split()
    return int(right), int(wrong), int(failed)


def counted(read, expected):
    right = wrong = failed = 0
    choice = random.Random(1)
    for _ in range(READS):
        number = choice.choice(NUMBERS)
        time.sleep(0.002)
        try:
            value = read(number)
        except Exception:  # whatever a client raises is its error
            failed += 1
            continue
        right += value == expected(number)
        wrong += value != expected(number)
    return right, wrong, failed


def pytrinamic(drive):
    client = SerialTmclInterface(drive.path, 9600, timeout_s=TIMEOUT)
    try:
        return counted(lambda n: client.get_axis_parameter(n, 0), lambda n: 1000 * n)
    finally:
        client.close()


def pymodbus(drive):
    client = ModbusSerialClient(drive.path, baudrate=115200, timeout=TIMEOUT, retries=0)
    client.connect()

    def read(number):
        answer = client.read_holding_registers(number, count=1, device_id=1)
        if answer.isError():
            raise OSError(answer)
        return answer.registers[0]

    try:
        return counted(read, lambda n: n)
    finally:
        client.close()


def minimal(drive):
    client = minimalmodbus.Instrument(drive.path, 1)
    client.serial.baudrate, client.serial.timeout = 115200, TIMEOUT
    try:
        return counted(client.read_register, lambda n: n)
    finally:
        client.serial.close()
        minimalmodbus._serialports.clear()


def libmodbus(drive):
    program = compiled("libmodbus_reads.c", "libmodbus")
    words = [program, drive.path, str(READS), str(int(1000 * TIMEOUT))]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=True)
    _, right, _, wrong, _, failed = done.stdout.split()
    return int(right), int(wrong), int(failed)


OTHERS = {
    Tmcl: {"PyTrinamic": pytrinamic},
    Rtu: {"libmodbus": libmodbus, "pymodbus": pymodbus, "minimalmodbus": minimal},
}


@pytest.mark.parametrize("protocol", [Tmcl, Rtu], ids=["tmcl", "modbus-rtu"])
@pytest.mark.parametrize("fault", FAULTS)
def test_one_fault(protocol, fault):
    drive = FaultyDrive(protocol, FAULTS[fault])
    right, wrong, failed = ours(drive)
    drive.close()
    print(f"\n{fault}: ours {right} right, {wrong} WRONG, {failed} failed", end="")
    for name, client in OTHERS[protocol].items():
        drive = FaultyDrive(protocol, FAULTS[fault])
        try:
            print("; {} {} right, {} WRONG, {} failed".format(name, *client(drive)), end="")
        except pytest.skip.Exception as reason:
            print(f"; {name}: {reason}", end="")
        drive.close()
    assert wrong == 0
    assert failed <= (4 if fault.startswith("four") else 1)
    assert right + failed == READS


@pytest.mark.parametrize("protocol", [Tmcl, Rtu], ids=["tmcl", "modbus-rtu"])
def test_a_write_whose_acknowledge_is_lost_is_executed_once(protocol):
    drive = FaultyDrive(protocol, lambda n, request, reply: [] if drive.writes else None)
    right, wrong, failed = ours(drive, WRITE[protocol], many=1)
    writes = drive.writes
    drive.close()
    assert len(writes) == 1, writes
    assert (right + wrong, failed) == (0, 1), "success must not be claimed"


@pytest.mark.parametrize("protocol", [Tmcl, Rtu], ids=["tmcl", "modbus-rtu"])
def test_babble_moves_nothing_and_ends(protocol):
    """A line on which somebody talks all the time: every read ends, none is wrong."""
    choice = random.Random(7)
    drive = FaultyDrive(
        protocol, lambda n, request, reply: [(0, choice.randbytes(40)), (0.001, reply)]
    )
    right, wrong, failed = ours(drive, many=20)
    drive.close()
    assert wrong == 0 and right + failed == 20
