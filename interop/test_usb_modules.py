"""Simulated modules as public clients of real ones expect them: on USB, in direct mode, and right after a start.

pylablib asks address 0, odemis' driver begins with nine zero bytes; both wait until a speed is 0.
"""

import os
import struct
import tty

import pytest
from conftest import end, start

OK, INVALID_COMMAND, NOT_AVAILABLE = 100, 2, 6
ROR, MST, MVP, SAP, GAP, SGP, GGP, SIO = 1, 3, 4, 5, 6, 9, 10, 14
CALC, COMP, JC, EI, DI, CLE, AAP, AGP, VECT, STOP = 19, 20, 21, 25, 26, 36, 34, 35, 37, 28


class Client:
    """Nine bytes out, nine bytes in."""

    def __init__(self, path):
        self.file = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self.file)

    def exchange(self, data):
        os.write(self.file, data)
        reply = b""
        while len(reply) < 9:
            reply += os.read(self.file, 9 - len(reply))
        assert sum(reply[:8]) & 255 == reply[8], reply
        return reply

    def ask(self, opcode, kind=0, motor=0, value=0, address=1):
        """Status and value."""
        request = struct.pack(">BBBBi", address, opcode, kind, motor, value)
        reply = self.exchange(request + bytes([sum(request) & 255]))
        return reply[2], struct.unpack(">i", reply[4:8])[0]


@pytest.fixture
def client(tmp_path):
    running = []

    def connect(*words):
        path = tmp_path / f"pty{len(running)}"
        process, _ = start(*words, "--pty", str(path))
        running.append((process, Client(path)))
        return running[-1][1]

    yield connect
    for process, module in running:
        os.close(module.file)
        end(process)


@pytest.mark.parametrize("drive", ["tmcm-1110", "tmcm-1140", "tmcm-1640", "tmcm-3110", "tmcm-6110"])
def test_a_module_on_usb_takes_any_address(client, drive):
    module = client(drive)
    for address in (0, 1, 7, 255):
        assert module.ask(GAP, 1, address=address) == (OK, 0)
    # Zero bytes are a request too: to address 0, with a right checksum and an opcode that there is not.
    assert module.exchange(bytes(9))[2] == INVALID_COMMAND


def test_two_modules_on_a_line_listen_to_their_address(client):
    module = client("tmcm-6110:1,3")
    assert module.exchange(struct.pack(">9B", 1, GAP, 1, 0, 0, 0, 0, 0, 8))[1] == 1
    assert module.exchange(struct.pack(">9B", 3, GAP, 1, 0, 0, 0, 0, 0, 10))[1] == 3


@pytest.mark.parametrize("drive", ["tmcm-1140", "tmcm-6110", "tmcm-171", "tmcm-1640", "tmcm-1260"])
def test_calculations_of_programs_are_executed_in_direct_mode(client, drive):
    module = client(drive)
    for request in (
        (CALC, 9, 0, 42), (COMP, 0, 0, 42), (CLE, 0, 0, 0), (VECT, 3, 0, 50), (EI, 3), (EI, 255), (DI, 255),
    ):
        assert module.ask(*request)[0] == OK, request
    assert module.ask(AGP, 7, 2)[0] == OK
    assert module.ask(GGP, 7, 2) == (OK, 42)
    # What leads through a program is for programs alone.
    for opcode in (JC, STOP):
        assert module.ask(opcode)[0] == NOT_AVAILABLE


def test_the_accumulator_sets_an_axis_parameter(client):
    module = client("tmcm-6110")
    assert module.ask(CALC, 9, 0, 321)[0] == OK
    assert module.ask(AAP, 4, 2)[0] == OK
    assert module.ask(GAP, 4, 2) == (OK, 321)
    assert module.ask(SIO, 0, 0, 0)[0] == OK


@pytest.mark.parametrize("drive", ["tmcm-1140", "tmcm-6110", "tmcm-1260"])
def test_the_first_reading_behind_a_start_is_that_of_a_motor_that_starts(client, drive):
    module = client(drive)
    for target in (20_000, -20_000, 40_000):
        assert module.ask(MVP, 0, 0, target)[0] == OK
        speed, arrived = (module.ask(GAP, kind)[1] for kind in (3, 8))
        assert speed and not arrived, (target, speed, arrived)
        # The acceleration is a parameter of modules with a TMC429.
        assert module.ask(GAP, 135)[1] or drive == "tmcm-1260"
    assert module.ask(ROR, 0, 0, 500)[0] == OK
    assert module.ask(GAP, 3)[1]
    assert module.ask(MST)[0] == OK


@pytest.mark.parametrize("drive", ["tmcm-1311", "tmcm-3351"])
def test_a_closed_loop_says_when_it_is_ready(client, drive):
    module = client(drive)
    assert module.ask(GAP, 133) == (OK, 0)
    assert module.ask(SAP, 129, 0, 1)[0] == OK
    assert module.ask(GAP, 133) == (OK, 1)
    assert module.ask(SAP, 129, 0, 0)[0] == OK
    assert module.ask(GAP, 133) == (OK, 0)


def test_a_stepper_module_has_end_switches_only_where_asked(client):
    bare, fitted = client("tmcm-1140"), client("tmcm-1140", "--ends=-1..1")
    for module, closed in ((bare, 0), (fitted, 1)):
        module.ask(SAP, 1, 0, 0)
        module.ask(MVP, 0, 0, 3_000)
        for _ in range(2000):
            if module.ask(GAP, 3)[1] == 0:
                break
        assert module.ask(GAP, 10) == (OK, closed)
