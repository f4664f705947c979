"""Trinamic's own Python client, and python-can itself, against our modules on CAN."""

import socket
import time

import can
import pytest
from conftest import end, polepair, start
from polepair_test_support import wait_until
from pytrinamic.connections import SlcanTmclInterface
from pytrinamic.connections.can_tmcl_interface import CanTmclInterface
from pytrinamic.tmcl import TMCLCommand, TMCLReplyStatusError
from test_pytrinamic import wait_for_speed

GROUP = "239.74.163.2"
MAX_CURRENT = 6


class UdpTmclInterface(CanTmclInterface):
    """The client's CAN interface on python-can's udp_multicast, which it does not offer itself."""

    def __init__(self, port, module_id=1):
        CanTmclInterface.__init__(self, GROUP, 0, 2, module_id, 30)
        self._connection = can.Bus(
            interface="udp_multicast", channel=GROUP, port=port, receive_own_messages=False
        )
        self._connection.set_filters([{"can_id": 2, "can_mask": 0x7FF}])


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]


@pytest.fixture
def udp():
    """A function that starts modules on a multicast group and gives its port."""
    running = []

    def drives(words):
        port = free_port()
        process, url = start(words, "--udp", f"{GROUP}:{port}")
        running.append(process)
        assert url.startswith(f"tmcl+udp://{GROUP}:{port}"), url
        return port

    yield drives
    for process in running:
        end(process)


@pytest.fixture(params=["udp", "slcan"])
def drive(request, udp, sim):
    if request.param == "udp":
        interface = UdpTmclInterface(udp("tmcl:1"))
    else:
        interface = SlcanTmclInterface(sim("tmcl+can:1"), datarate=250_000, timeout_s=30)
    yield interface
    interface.close()


def test_version(drive):
    reply = drive.send(TMCLCommand.GET_FIRMWARE_VERSION, 1, 0, 0)
    assert reply.value >> 16 in (170, 171)


def test_rotates_both_ways_and_stops(drive):
    drive.set_axis_parameter(11, 0, 5000)
    drive.send(TMCLCommand.ROR, 0, 0, 350)
    wait_for_speed(drive, 350)
    drive.send(TMCLCommand.ROL, 0, 0, 350)
    wait_for_speed(drive, -350)
    drive.send(TMCLCommand.MST, 0, 0, 0)
    wait_for_speed(drive, 0, within=2)


def test_settings_and_refusals(drive):
    drive.set_axis_parameter(MAX_CURRENT, 0, 42)
    assert drive.get_axis_parameter(MAX_CURRENT, 0) == 42
    with pytest.raises(TMCLReplyStatusError) as error:
        drive.get_axis_parameter(111, 0)
    assert error.value.reply.status == 3


def test_two_modules_and_two_hosts_on_one_bus(udp):
    port = udp("tmcl:1,3")
    interface = UdpTmclInterface(port)
    interface.set_axis_parameter(MAX_CURRENT, 0, 11, module_id=1)
    # Our own host joins the same group as another host.
    shown = polepair("set", f"tmcl+udp://{GROUP}:{port}#3", "max current=2.2A").stdout
    assert shown == "max current = 2.2 A (22)\n"
    time.sleep(0.1)
    while interface._connection.recv(0.1):
        pass  # the replies that our host got
    assert interface.get_axis_parameter(MAX_CURRENT, 0, module_id=1) == 11
    assert interface.get_axis_parameter(MAX_CURRENT, 0, module_id=3) == 22
    interface.close()


def test_python_can_reads_and_writes_frames(udp):
    with can.Bus(interface="udp_multicast", channel=GROUP, port=udp("tmcl:1")) as bus:
        request = can.Message(
            arbitration_id=1, data=bytes.fromhex("06 06 00 00 00 00 00"), is_extended_id=False
        )
        bus.send(request)
        frame = wait_until(
            "a reply to host 2", lambda: bus.recv(0.2), lambda frame: frame is not None and frame.arbitration_id == 2
        )
        # Module 1, status 100, opcode 6, the factory's 100.
        assert bytes(frame.data) == bytes.fromhex("01 64 06 00 00 00 64")
