"""Polepair as an interface of python-can: foreign programs over our wires."""

from __future__ import annotations

import threading
import time

import can
import canopen
import polepair
import pytest
from polepair.can import WAITING_MAX
from polepair_test_support import wait_until


def test_python_can_speaks_with_a_simulated_module() -> None:
    with can.Bus(interface="polepair", channel="sim:tmcl+can") as bus:
        # GAP 1: actual position (TMCL reference, chapter 3).
        data = [6, 1, 0, 0, 0, 0, 0]
        bus.send(can.Message(arbitration_id=1, data=data, is_extended_id=False))
        reply = bus.recv(2.0)
        assert reply is not None
        assert (reply.arbitration_id, list(reply.data)) == (2, [1, 100, 6, 0, 0, 0, 0])
        assert abs(reply.timestamp - time.time()) < 5.0
        assert bus.recv(0.05) is None


def test_python_canopen_finds_and_moves_simulated_nodes() -> None:
    network = canopen.Network()
    network.connect(interface="polepair", channel="sim:syntron-ts-canopen:2,3")
    try:
        # A boot-up message makes a node known as well: the replies to the search are waited for.
        answered: set[int] = set()
        for cob in (0x582, 0x583):
            network.subscribe(cob, lambda cob, _data, _at: answered.add(cob))
        network.scanner.search()
        wait_until("replies of both nodes", lambda: answered, lambda cobs: len(cobs) == 2)
        assert sorted(network.scanner.nodes) == [2, 3]
        node = network.add_node(2, canopen.ObjectDictionary())
        assert int.from_bytes(node.sdo.upload(0x6041, 0), "little") & 0x6F == 0x40
        node.sdo.download(0x2000, 0, (20).to_bytes(2, "little"))
        node.sdo.download(0x6060, 0, b"\x03")
        for word in (6, 7, 15):
            node.sdo.download(0x6040, 0, word.to_bytes(2, "little"))
        node.sdo.download(0x60FF, 0, (3000).to_bytes(4, "little"))
        wait_until(
            "the speed is 300",
            lambda: int.from_bytes(node.sdo.upload(0x606C, 0), "little", signed=True),
            lambda speed: abs(speed - 300) < 15,
        )
    finally:
        network.disconnect()


def test_filters_and_own_messages() -> None:
    bus = can.Bus(
        interface="polepair",
        channel="sim:tmcl+can",
        receive_own_messages=True,
        can_filters=[{"can_id": 2, "can_mask": 0x7FF}],
    )
    with bus:
        bus.send(can.Message(arbitration_id=1, data=[6, 1, 0, 0, 0, 0, 0], is_extended_id=False))
        heard = bus.recv(2.0)
        assert heard is not None and heard.arbitration_id == 2
    with pytest.raises(can.CanOperationError):
        bus.send(can.Message(arbitration_id=1))


@pytest.mark.parametrize("channel", ["test", None, 7, "sim:tmcl+can"])
def test_buses_of_a_channel_share_it(channel: object) -> None:
    frame = can.Message(arbitration_id=0x321, data=b"\x01\x02", is_extended_id=False)
    with (
        can.Bus(interface="polepair", channel=channel) as one,
        can.Bus(interface="polepair", channel=channel, receive_own_messages=True) as two,
        can.Bus(interface="polepair", channel="elsewhere") as stranger,
    ):
        before = time.time()
        two.send(frame)
        heard, own = one.recv(2.0), two.recv(2.0)
        assert heard is not None and own is not None
        assert (heard.is_rx, own.is_rx, heard.channel) == (True, False, channel)
        assert heard.equals(frame, timestamp_delta=None, check_channel=False)
        assert before <= heard.timestamp <= time.time() and heard.timestamp == own.timestamp
        heard.data[0] = 99
        assert own.data[0] == 1
        one.send(frame)
        assert one.recv(0.01) is None
        assert two.recv(2.0) is not None
        assert stranger.recv(0) is None
        with pytest.raises(can.CanOperationError, match="FD"):
            one.send(can.Message(arbitration_id=1, is_fd=True))


def test_programs_on_one_simulated_bus_hear_what_it_answers() -> None:
    ask = can.Message(arbitration_id=1, data=[6, 1, 0, 0, 0, 0, 0], is_extended_id=False)
    with (
        can.Bus(interface="polepair", channel="sim:tmcl+can") as host,
        can.Bus(interface="polepair", channel="sim:tmcl+can") as ear,
    ):
        heard: list[can.Message] = []
        # The ear waits first, and so reads for both.
        with_ear = threading.Thread(
            target=lambda: heard.extend(m for m in (ear.recv(20.0), ear.recv(20.0)) if m)
        )
        with_ear.start()
        host.send(ask)
        answer = host.recv(20.0)
        with_ear.join()
        assert answer is not None
        assert [m.arbitration_id for m in heard] == [1, 2]
        assert answer.data == heard[1].data and answer.timestamp == heard[1].timestamp


@pytest.mark.parametrize("channel", ["test", "sim:tmcl+can"])
def test_a_bus_that_is_shut_down_keeps_no_caller_waiting(channel: str) -> None:
    bus = can.Bus(interface="polepair", channel=channel)
    told: list[str] = []

    def wait() -> None:
        try:
            bus.recv()
        except can.CanOperationError as error:
            told.append(str(error))

    waits = threading.Thread(target=wait)
    waits.start()
    time.sleep(0.05)
    bus.shutdown()
    waits.join(timeout=120)
    assert told == ["this bus is shut down"]
    with pytest.raises(can.CanOperationError):
        bus.recv(0)


def test_an_adapter_that_cannot_be_opened_raises_python_cans_error() -> None:
    for channel, why in [("sim:tmcll", "tmcl"), ("sim:tmcl", "not one CAN bus")]:
        with pytest.raises(can.CanInitializationError, match=why):
            can.Bus(interface="polepair", channel=channel)


def test_unread_frames_are_bounded_and_counted() -> None:
    frame = can.Message(arbitration_id=1, data=bytes(8), is_extended_id=False)
    with (
        can.Bus(interface="polepair", channel="full") as speaks,
        can.Bus(interface="polepair", channel="full") as sleeps,
    ):
        for _ in range(WAITING_MAX + 5):
            speaks.send(frame)
        assert sleeps.lost == 5 and len(sleeps.waiting) == WAITING_MAX


def test_any_bus_of_python_can_is_a_link() -> None:
    # python-can's own bus in the middle: our simulated module behind one end, our host at the other.
    with (
        can.Bus(interface="polepair", channel="sim:tmcl+can:3") as bus,
        polepair.connect(bus, protocol="tmcl", axes=[3]) as link,
    ):
        axis = link.axis(3)
        assert axis.product == "tmcm-171"
        axis.params["max current"] = 1.5
        assert axis.params.raw["max current"] == 15
        with axis.armed():
            axis.move(0.5, velocity=(120, "rpm")).wait()
        assert axis.read("position")["position"] == pytest.approx(0.5, abs=0.02)


def test_unread_frames_of_an_adapter_are_counted() -> None:
    with (
        can.Bus(interface="polepair", channel="sim:tmcl+can:3") as bus,
        can.Bus(interface="polepair", channel="sim:tmcl+can:3") as babbler,
        polepair.connect(bus, protocol="tmcl", axes=[3]) as link,
    ):
        assert [lost.overrun for lost in link.losses()] == [0]
        frame = can.Message(arbitration_id=0x7F0, data=bytes(8), is_extended_id=False)

        def overrun() -> int:
            for _ in range(1000):
                babbler.send(frame)
            return link.losses()[0].overrun

        wait_until("frames are lost", overrun)


def test_a_device_that_is_no_adapter_is_reported() -> None:
    with pytest.raises(TypeError, match="neither"):
        polepair.connect(42, protocol="tmcl")  # type: ignore[arg-type]
    with can.Bus(interface="virtual", channel="nobody") as bus:
        with pytest.raises(TypeError, match="protocol"):
            polepair.connect(bus)
        with pytest.raises(polepair.NoReply):
            polepair.connect(bus, protocol="tmcl", axes=[1])
