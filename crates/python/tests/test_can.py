"""Polepair as an interface of python-can: foreign programs over our wires."""

from __future__ import annotations

import time

import can
import canopen
import polepair
import pytest


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
        network.scanner.search()
        time.sleep(0.5)
        assert sorted(network.scanner.nodes) == [2, 3]
        node = network.add_node(2, canopen.ObjectDictionary())
        assert int.from_bytes(node.sdo.upload(0x6041, 0), "little") & 0x6F == 0x40
        node.sdo.download(0x2000, 0, (20).to_bytes(2, "little"))
        node.sdo.download(0x6060, 0, b"\x03")
        for word in (6, 7, 15):
            node.sdo.download(0x6040, 0, word.to_bytes(2, "little"))
        node.sdo.download(0x60FF, 0, (3000).to_bytes(4, "little"))
        deadline = time.monotonic() + 10
        while time.monotonic() < deadline:
            speed = int.from_bytes(node.sdo.upload(0x606C, 0), "little", signed=True)
            if abs(speed - 300) < 15:
                break
            time.sleep(0.05)
        assert abs(speed - 300) < 15
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


def test_what_is_no_adapter_is_told() -> None:
    with pytest.raises(TypeError, match="neither"):
        polepair.connect(42, protocol="tmcl")  # type: ignore[arg-type]
    with can.Bus(interface="virtual", channel="nobody") as bus:
        with pytest.raises(TypeError, match="protocol"):
            polepair.connect(bus)
        with pytest.raises(polepair.NoReply):
            polepair.connect(bus, protocol="tmcl", axes=[1])
