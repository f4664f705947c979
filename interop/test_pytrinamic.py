"""Trinamic's own Python client against our TMCM-170 and TMCM-171."""

import time

import pytest
from polepair_test_support import wait_until
from pytrinamic.connections import SerialTmclInterface
from pytrinamic.tmcl import TMCLCommand, TMCLReplyStatusError

TARGET_POSITION, POSITION, TARGET_SPEED, SPEED, FLAGS, STEPS = 0, 1, 2, 3, 156, 250
POS_END = 1 << 7


@pytest.fixture
def drive(sim):
    interface = SerialTmclInterface(sim("tmcl:1"), 115200, timeout_s=30)
    yield interface
    interface.close()


def status_of(call):
    with pytest.raises(TMCLReplyStatusError) as error:
        call()
    return error.value.reply.status


def test_version(drive):
    text = drive.get_version_string()
    assert text[:3] in ("170", "171") and text[3] == "V", text
    reply = drive.send(TMCLCommand.GET_FIRMWARE_VERSION, 1, 0, 0)
    assert reply.value >> 16 in (170, 171)


def wait_for_speed(drive, rpm, within=5):
    wait_until(
        f"the speed is {rpm} rpm",
        lambda: drive.get_axis_parameter(SPEED, 0, signed=True),
        lambda speed: abs(speed - rpm) <= within,
    )


def test_rotates_both_ways_and_stops(drive):
    drive.set_axis_parameter(11, 0, 5000)
    drive.send(TMCLCommand.ROR, 0, 0, 350)
    wait_for_speed(drive, 350)
    drive.send(TMCLCommand.ROL, 0, 0, 350)
    wait_for_speed(drive, -350)
    drive.send(TMCLCommand.MST, 0, 0, 0)
    wait_for_speed(drive, 0, within=2)


def test_moves_absolute_and_relative(drive):
    steps = drive.get_axis_parameter(STEPS, 0)
    drive.set_axis_parameter(4, 0, 2000)
    drive.send(TMCLCommand.MVP, 0, 0, 2 * steps)
    wait_until("the flag POS_END is set", lambda: drive.get_axis_parameter(FLAGS, 0), lambda flags: flags & POS_END)
    assert abs(drive.get_axis_parameter(POSITION, 0, signed=True) - 2 * steps) <= 20
    reply = drive.send(TMCLCommand.MVP, 1, 0, -3 * steps)
    target = reply.value - 2**32 if reply.value >= 2**31 else reply.value
    assert abs(target - -steps) <= 20
    wait_until("the flag POS_END is set", lambda: drive.get_axis_parameter(FLAGS, 0), lambda flags: flags & POS_END)
    assert abs(drive.get_axis_parameter(POSITION, 0, signed=True) - target) <= 20


def test_position_can_be_set_without_moving(drive):
    drive.set_axis_parameter(POSITION, 0, -123456789)
    assert abs(drive.get_axis_parameter(POSITION, 0, signed=True) + 123456789) <= 2
    assert abs(drive.get_axis_parameter(SPEED, 0, signed=True)) <= 2


def test_axis_parameters_are_kept_when_stored(drive):
    assert drive.get_axis_parameter(253, 0) == 8
    drive.set_axis_parameter(4, 0, 1234)
    drive.store_axis_parameter(4, 0)
    drive.set_axis_parameter(4, 0, 999)
    drive.restore_axis_parameter(4, 0)
    assert drive.get_axis_parameter(4, 0) == 1234


def test_global_parameters_and_the_eeprom_lock(drive):
    assert drive.get_global_parameter(66, 0) == 1
    drive.set_global_parameter(5, 2, -77)
    assert drive.get_global_parameter(5, 2, signed=True) == -77
    drive.set_global_parameter(73, 0, 1234)
    assert drive.get_global_parameter(73, 0) == 1
    assert status_of(lambda: drive.store_axis_parameter(4, 0)) == 5
    drive.set_global_parameter(73, 0, 4321)
    drive.store_axis_parameter(4, 0)


def test_every_error_status(drive):
    assert status_of(lambda: drive.send(99, 0, 0, 0)) == 2
    assert status_of(lambda: drive.send(TMCLCommand.MVP, 7, 0, 0)) == 3
    assert status_of(lambda: drive.get_axis_parameter(111, 0)) == 3
    assert status_of(lambda: drive.set_axis_parameter(253, 0, 100000)) == 4
    assert status_of(lambda: drive.get_axis_parameter(1, 1)) == 4
    assert status_of(lambda: drive.send(TMCLCommand.RFS, 0, 0, 0)) == 2
    assert drive.get_axis_parameter(1, 0) is not None, "still in step after errors"


def test_a_wrong_checksum_is_status_1(drive):
    port = drive._serial
    port.write(bytes.fromhex("01 06 01 00 00 00 00 00 09"))
    reply = port.read(9)
    assert len(reply) == 9 and reply[2] == 1
    assert drive.get_axis_parameter(1, 0) is not None


def test_two_modules_on_one_line(sim):
    interface = SerialTmclInterface(sim("tmcl:1,2"), 115200, timeout_s=30)
    interface.set_axis_parameter(4, 0, 111, module_id=1)
    interface.set_axis_parameter(4, 0, 222, module_id=2)
    assert interface.get_axis_parameter(4, 0, module_id=1) == 111
    assert interface.get_axis_parameter(4, 0, module_id=2) == 222
    interface.close()


def test_an_absent_module_is_silent(sim):
    interface = SerialTmclInterface(sim("tmcl:1"), 115200, timeout_s=0.3)
    began = time.monotonic()
    with pytest.raises(RuntimeError):
        interface.get_axis_parameter(1, 0, module_id=9)
    assert time.monotonic() - began < 30
    interface.close()
