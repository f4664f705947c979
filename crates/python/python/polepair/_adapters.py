"""Adapters that the caller opened, as the native half uses them."""

from __future__ import annotations

from typing import Any, Protocol

__all__ = ["SerialPort", "adapter"]

PAUSE = 0.05
"""Seconds that a read waits before the reader looks whether the link was closed."""


class SerialPort(Protocol):
    """The used part of pyserial's port."""

    timeout: float | None
    baudrate: int

    @property
    def in_waiting(self) -> int:
        """Bytes that were read by the system and not yet by us."""

    def read(self, size: int = 1, /) -> bytes:
        """At most so many bytes, after `timeout` seconds fewer."""

    def write(self, data: bytes, /) -> int | None:
        """All of them."""


class CanAdapter:
    """A bus of python-can's."""

    def __init__(self, bus: Any) -> None:
        import can

        self._bus = bus
        self._message = can.Message

    def receive(self) -> tuple[int, bool, bool, int, bytes] | None:
        message = self._bus.recv(PAUSE)
        if message is None or message.is_error_frame or message.is_fd or not message.is_rx:
            return None
        data = bytes(message.data or b"")
        return (
            message.arbitration_id,
            message.is_extended_id,
            message.is_remote_frame,
            message.dlc,
            data,
        )

    def send(self, unit: tuple[int, bool, bool, int, bytes]) -> None:
        identifier, extended, remote, length, data = unit
        self._bus.send(
            self._message(
                arbitration_id=identifier,
                is_extended_id=extended,
                is_remote_frame=remote,
                dlc=length,
                data=None if remote else data,
            )
        )

    def line(self, rate: int) -> None:
        """The bit rate of an external bus is set by its creator."""

    def close(self) -> None:
        """The bus is its opener's to close."""


class SerialAdapter:
    """A port as pyserial has them."""

    def __init__(self, port: SerialPort) -> None:
        self._port = port
        port.timeout = PAUSE

    def receive(self) -> bytes | None:
        return self._port.read(max(1, self._port.in_waiting)) or None

    def send(self, unit: bytes) -> None:
        self._port.write(unit)

    def line(self, rate: int) -> None:
        if rate:
            self._port.baudrate = rate

    def close(self) -> None:
        """The port is its opener's to close."""


def adapter(opened: Any) -> tuple[CanAdapter | SerialAdapter, str, bool]:
    """The object for the native half, its name, and True for a bus."""
    if hasattr(opened, "recv") and hasattr(opened, "send"):
        return CanAdapter(opened), str(getattr(opened, "channel_info", "a bus")), True
    if hasattr(opened, "read") and hasattr(opened, "write"):
        name = getattr(opened, "port", None) or getattr(opened, "name", None) or "a port"
        return SerialAdapter(opened), str(name), False
    raise TypeError(
        f"{type(opened).__name__} is neither a connection string, nor a bus of python-can, nor a "
        "port with read and write"
    )
