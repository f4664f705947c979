"""Polepair's links and simulators as an interface of python-can.

    bus = can.Bus(interface="polepair", channel="canopen+udp://239.74.163.2:43113")
    bus = can.Bus(interface="polepair", channel="sim:canopen:2")

So canopen and cantools run over every adapter that Polepair opens, and against its simulated drives.
Needs `polepair[can]`.
"""

from __future__ import annotations

import time
from typing import Any

import can

from . import _polepair as native

__all__ = ["Bus"]


class Bus(can.BusABC):
    """A CAN wire that Polepair opened.

    `channel` is a connection string without axes. Of a simulated drive each bus has its own.
    Frames of CAN FD are refused: no drive here speaks it.
    """

    def __init__(
        self,
        channel: str,
        can_filters: Any = None,
        receive_own_messages: bool = False,
        **kwargs: Any,
    ) -> None:
        self._wire: native.CanWire | None = native.CanWire(channel)
        self.channel_info = f"polepair {self._wire.describe()}"
        self._own: list[can.Message] = []
        self._echoes = receive_own_messages
        self._offset: float | None = None
        super().__init__(channel=channel, can_filters=can_filters, **kwargs)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self._own:
            return self._own.pop(0), False
        heard = self._open().receive(float("inf") if timeout is None else timeout)
        if heard is None:
            return None, False
        at, identifier, extended, remote, length, data = heard
        if self._offset is None:
            # The wire's clock counts from its own beginning; python-can's from 1970.
            self._offset = time.time() - at
        message = can.Message(
            timestamp=self._offset + at,
            arbitration_id=identifier,
            is_extended_id=extended,
            is_remote_frame=remote,
            dlc=length,
            data=None if remote else data,
            channel=self.channel_info,
        )
        return message, False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Sends a frame; `timeout` is not needed: a frame is handed over at once."""
        if msg.is_fd:
            raise can.CanOperationError("CAN FD is spoken by no drive here")
        data = bytes(msg.data)
        try:
            self._open().send(
                msg.arbitration_id, msg.is_extended_id, msg.is_remote_frame, msg.dlc, data
            )
        except OSError as error:
            raise can.CanOperationError(str(error)) from error
        if self._echoes:
            self._own.append(msg)

    def _open(self) -> native.CanWire:
        if self._wire is None:
            raise can.CanOperationError("this bus is shut down")
        return self._wire

    def shutdown(self) -> None:
        """Closes the wire."""
        super().shutdown()
        self._wire = None
