"""pymodbus, minimalmodbus, libmodbus and mbpoll against our Syntron TS."""

import subprocess

import minimalmodbus
import pytest
from conftest import compiled, need
from polepair_test_support import wait_until
from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient

SPEED, ALARM, BUSY = 0x1000, 0x1012, 0x101C
CONTROL_MODE, RAM, INTERNAL_SPEED, ENABLE = 0x00, 0x99, 0x33, 0x38


class Pymodbus:
    def __init__(self, path, framer):
        self.client = ModbusSerialClient(path, framer=framer, baudrate=115200, timeout=10, retries=0)
        assert self.client.connect()

    def read(self, address, count=1):
        answer = self.client.read_holding_registers(address, count=count, device_id=1)
        assert not answer.isError(), answer
        return answer.registers

    def write(self, address, *values):
        if len(values) == 1:
            answer = self.client.write_register(address, values[0], device_id=1)
        else:
            answer = self.client.write_registers(address, list(values), device_id=1)
        assert not answer.isError(), answer


class Minimalmodbus:
    def __init__(self, path, mode):
        self.instrument = minimalmodbus.Instrument(path, 1, mode=mode)
        self.instrument.serial.baudrate = 115200
        self.instrument.serial.timeout = 10

    def read(self, address, count=1):
        return self.instrument.read_registers(address, count)

    def write(self, address, *values):
        if len(values) == 1:
            self.instrument.write_register(address, values[0], functioncode=6)
        else:
            self.instrument.write_registers(address, list(values))


@pytest.fixture(params=["pymodbus-rtu", "pymodbus-ascii", "minimalmodbus-rtu", "minimalmodbus-ascii"])
def client(request, sim):
    library, framing = request.param.split("-")
    path = sim(f"modbus-{framing}:1")
    if library == "pymodbus":
        yield Pymodbus(path, FramerType.RTU if framing == "rtu" else FramerType.ASCII)
    else:
        mode = minimalmodbus.MODE_RTU if framing == "rtu" else minimalmodbus.MODE_ASCII
        yield Minimalmodbus(path, mode)
        minimalmodbus._serialports.clear()


def signed(word):
    return word - 0x10000 if word & 0x8000 else word


def wait_for_speed(client, rpm, within=3):
    wait_until(
        f"the speed is {rpm} rpm",
        lambda: signed(client.read(SPEED)[0]),
        lambda speed: abs(speed - rpm) <= within,
    )


def test_factory_values(client):
    assert client.read(CONTROL_MODE) == [2]
    assert client.read(0x3A) == [1]
    assert client.read(0x3F) == [9870]
    assert client.read(0x102E, 2) == [0, 0]


def test_internal_speed(client):
    client.write(CONTROL_MODE, 1)
    client.write(RAM, 1)
    client.write(INTERNAL_SPEED, 0)
    client.write(ENABLE, 0)
    client.write(INTERNAL_SPEED, 200)
    client.write(ENABLE, 1)
    wait_for_speed(client, 200)
    client.write(INTERNAL_SPEED, 0x10000 - 150)
    wait_for_speed(client, -150)
    client.write(ENABLE, 0)
    wait_for_speed(client, 0, within=2)


def test_a_path_is_run(client):
    client.write(CONTROL_MODE, 14)
    client.write(RAM, 1)
    client.write(0x20A, 1)
    client.write(0x20B, 1)
    client.write(0x205, 1)
    client.write(0x206, 360)
    # One turn: absolute, single, 36 tens + 0, 600 rpm, 100 ms up and down.
    client.write(0x100, 1002, 36, 0, 600, 100, 100, 0, 0)
    client.write(0x20C, 0)
    client.write(ENABLE, 1)
    before = client.read(0x102E, 2)
    client.write(0x20C, 1)
    client.write(0x20C, 0)
    # The path is short: a busy machine may see no more of it than its end.
    wait_until("the position changes", lambda: client.read(0x102E, 2), lambda now: now != before)
    wait_until("the drive is not busy", lambda: client.read(BUSY), lambda busy: busy == [0])
    assert client.read(ALARM) == [0]


def test_homing(client):
    client.write(CONTROL_MODE, 14)
    client.write(RAM, 1)
    client.write(0x20A, 1)
    # Way: Z pulse directly, forward (C = 5).
    client.write(0x200, 2 * 10000 + 5 * 1000)
    client.write(0x201, 100)
    client.write(0x202, 20)
    client.write(0x20D, 0)
    client.write(ENABLE, 1)
    client.write(0x20D, 1)
    client.write(0x20D, 0)
    wait_until("the drive is not busy", lambda: client.read(BUSY), lambda busy: busy == [0])
    assert client.read(ALARM) == [0]


def test_outputs_and_inputs(sim):
    client = Pymodbus(sim("modbus-rtu:1"), FramerType.RTU).client
    outputs = client.read_coils(0, count=4, device_id=1)
    inputs = client.read_discrete_inputs(0, count=8, device_id=1)
    assert len(outputs.bits) == 8 and len(inputs.bits) == 8


def test_every_exception(sim):
    client = Pymodbus(sim("modbus-rtu:1"), FramerType.RTU).client

    def exception(answer):
        assert answer.isError()
        return answer.exception_code

    assert exception(client.read_input_registers(0, count=1, device_id=1)) == 1
    assert exception(client.read_holding_registers(0x0300, count=1, device_id=1)) == 2
    assert exception(client.write_register(0x1000, 1, device_id=1)) in (2, 3)
    assert exception(client.write_register(0x00, 999, device_id=1)) == 3
    assert exception(client.write_register(0x3D, 3, device_id=1)) == 3
    assert not client.read_holding_registers(0, count=1, device_id=1).isError()


def test_libmodbus(sim):
    program = compiled("libmodbus_client.c", "libmodbus")
    done = subprocess.run(
        [program, sim("modbus-rtu:1")], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "all as expected" in done.stdout


def test_mbpoll(sim):
    need("mbpoll")
    path = sim("modbus-rtu:1")
    common = ["mbpoll", "-m", "rtu", "-a", "1", "-b", "115200", "-P", "none", "-0", "-1"]

    def run(*words):
        return subprocess.run(
            [*common, *words], capture_output=True, text=True, timeout=120, check=False
        )

    wrote = run("-r", "51", path, "200")
    assert wrote.returncode == 0 and "Written 1 references" in wrote.stdout, wrote.stdout
    read = run("-r", "51", "-c", "1", path)
    assert "[51]: \t200" in read.stdout, read.stdout
    refused = run("-r", "768", "-c", "1", path)
    assert refused.returncode != 0 or "Illegal data address" in refused.stdout + refused.stderr
