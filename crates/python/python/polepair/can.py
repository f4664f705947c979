"""Polepair's links and simulators as an interface of python-can.

    bus = can.Bus(interface="polepair", channel="canopen+udp://239.74.163.2:43113")
    bus = can.Bus(interface="polepair", channel="sim:canopen:2")
    bus = can.Bus(interface="polepair", channel="test")     # only within this process

So canopen and cantools run over every adapter that Polepair opens, and against its simulated drives.
Buses of one channel share it, as programs share an interface of the kernel's: each hears what the
others send. Needs `polepair[can]`.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Hashable
from typing import Any, ClassVar

import can

from . import _polepair as native
from .errors import PolepairError

__all__ = ["Bus"]

WAITING_MAX = 1 << 16
"""Unread frames that a bus keeps; further ones are lost, counted and reported."""

LOG = logging.getLogger("can.polepair")


class Channel:
    """A wire, or none, and the buses of this process on it. The first waiting bus reads for all."""

    opened: ClassVar[dict[Hashable, Channel]] = {}
    opening: ClassVar[threading.Lock] = threading.Lock()

    def __init__(self, name: Hashable) -> None:
        self.name = name
        self.wire = native.CanWire(name) if isinstance(name, str) and _is_url(name) else None
        # The wire's clock counts from its own beginning; python-can's from 1970.
        self.began = time.time() - self.wire.now() if self.wire else 0.0
        self.buses: list[Bus] = []
        self.changed = threading.Condition()
        self.led = False

    @classmethod
    def join(cls, name: Hashable, bus: Bus) -> Channel:
        """The channel of that name, opened at its first use."""
        with cls.opening:
            channel = cls.opened.get(name) or cls(name)
            cls.opened[name] = channel
            channel.buses.append(bus)
            return channel

    def leave(self, bus: Bus) -> None:
        """Closes it behind the last one."""
        with self.opening, self.changed:
            if bus not in self.buses:
                return
            self.buses.remove(bus)
            if not self.buses:
                del self.opened[self.name]
            self._tell()

    def send(self, bus: Bus, message: can.Message) -> None:
        """Sends a frame to the wire, and to the other buses of this process."""
        # Under the lock, so that no answer is delivered before its request.
        with self.changed:
            if self.wire is not None:
                self.wire.send(
                    message.arbitration_id,
                    message.is_extended_id,
                    message.is_remote_frame,
                    message.dlc,
                    bytes(message.data),
                )
            now = time.time()
            for other in self.buses:
                if other is not bus or bus.receive_own_messages:
                    other.keep(_copy(message, now, other.channel, is_rx=other is not bus))
            self._tell()

    def receive(self, bus: Bus, timeout: float | None) -> can.Message | None:
        """The next frame for that bus, or None after so many seconds."""
        ends = None if timeout is None else time.monotonic() + timeout
        over = False
        with self.changed:
            while not bus.waiting:
                left = float("inf") if ends is None else max(0.0, ends - time.monotonic())
                if over:
                    return None
                if bus._is_shutdown and ends is None:
                    raise can.CanOperationError("this bus is shut down")
                # A closed bus gets no more frames; its waiting reader ends without an error.
                if self.wire is None or self.led or bus._is_shutdown:
                    over = not self.changed.wait(None if ends is None else left)
                else:
                    over = self._lead(self.wire, left)
            return bus.waiting.popleft()

    def _lead(self, wire: native.CanWire, seconds: float) -> bool:
        """Reads a frame for everybody, without the lock; whether the time is up."""
        self.led = True
        self.changed.release()
        heard, over = None, False
        try:
            heard, over = wire.receive(seconds)
        finally:
            self.changed.acquire()
            self.led = False
            self.changed.notify_all()
        if heard is not None:
            at, identifier, extended, remote, length, data = heard
            message = can.Message(
                arbitration_id=identifier,
                is_extended_id=extended,
                is_remote_frame=remote,
                dlc=length,
                data=None if remote else data,
            )
            for bus in self.buses:
                bus.keep(_copy(message, self.began + at, bus.channel, is_rx=True))
        return over

    def _tell(self) -> None:
        self.changed.notify_all()
        if self.wire is not None and self.led:
            self.wire.wake()


class Bus(can.BusABC):
    """A CAN wire that Polepair opened.

    `channel` is a connection string without axes; any other text is a bus within this process.
    Frames of CAN FD are refused: no supported drive uses them.
    """

    def __init__(
        self,
        channel: Any = None,
        can_filters: Any = None,
        receive_own_messages: bool = False,
        **kwargs: Any,
    ) -> None:
        self.channel = channel
        self.receive_own_messages = receive_own_messages
        self.waiting: deque[can.Message] = deque()
        self.lost = 0
        """Frames that were lost because they were not read in time."""
        super().__init__(channel=channel, can_filters=can_filters, **kwargs)
        try:
            self._shared = Channel.join(channel, self)
        except PolepairError as error:
            raise can.CanInitializationError(f"{error}. {error.hint}") from error
        wire = self._shared.wire
        self.channel_info = f"polepair {wire.describe() if wire else channel}"

    def keep(self, message: can.Message) -> None:
        """Keeps a frame until it is read."""
        if len(self.waiting) < WAITING_MAX:
            self.waiting.append(message)
            return
        if not self.lost:
            LOG.warning("%s: frames are lost, because they are not read", self.channel_info)
        self.lost += 1

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self._check()
        try:
            return self._shared.receive(self, timeout), False
        except OSError as error:
            raise can.CanOperationError(str(error)) from error

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Sends a frame; `timeout` is not needed: a frame is handed over at once."""
        self._check()
        if msg.is_fd or msg.dlc > 8:
            raise can.CanOperationError("CAN FD is spoken by no drive here")
        if msg.is_error_frame:
            raise can.CanOperationError("error frames are the controller's to send")
        try:
            self._shared.send(self, msg)
        except OSError as error:
            raise can.CanOperationError(str(error)) from error

    def _check(self) -> None:
        if self._is_shutdown:
            raise can.CanOperationError("this bus is shut down")

    def shutdown(self) -> None:
        """Leaves the channel; the last one closes the wire."""
        super().shutdown()
        self._shared.leave(self)


def _is_url(name: str) -> bool:
    return ":" in name or name.startswith("@")


def _copy(message: can.Message, timestamp: float, channel: Any, *, is_rx: bool) -> can.Message:
    """Each bus has a message of its own."""
    return can.Message(
        timestamp=timestamp,
        arbitration_id=message.arbitration_id,
        is_extended_id=message.is_extended_id,
        is_remote_frame=message.is_remote_frame,
        dlc=message.dlc,
        data=None if message.is_remote_frame else bytes(message.data),
        channel=channel,
        is_rx=is_rx,
    )
