"""Node-IDs and bit rates of CANopen devices by layer setting services (LSS, CiA 305).

A device is addressed by the four numbers of its object 1018h, whether it has a node-ID or not.

>>> from polepair.lss import LssMaster
>>> with LssMaster("sim:canopen?axes=2&time=virtual") as lss:
...     identity = lss.identity_of(2)
...     lss.select(identity)
...     lss.set_node_id(9)
...     lss.leave_configuration()
...     lss.restart_communication(2)
...     lss.node_answers(9)
True
True
"""

from __future__ import annotations

from os import PathLike
from typing import NamedTuple, TypeVar

from . import _polepair as native

__all__ = ["LssIdentity", "LssMaster"]

_Self = TypeVar("_Self", bound="LssMaster")


class LssIdentity(NamedTuple):
    """The four numbers of object 1018h, which together name one device."""

    vendor: int
    """Vendor-ID, 1018h:1."""
    product: int
    """Product code, 1018h:2."""
    revision: int
    """Revision number, 1018h:3."""
    serial: int
    """Serial number, 1018h:4."""


class LssMaster:
    """The LSS master of a CAN bus. When it is closed, devices that it set to LSS configuration leave that state.

    Errors: `NoReply` if no device replies, `Refused` if the device refuses.
    """

    __slots__ = ("_native", "_url")

    def __init__(self, url: str, *, profile: str | PathLike[str] | None = None) -> None:
        """Opens the bus. Devices that another master left in LSS configuration leave that state.

        Errors: `Unsupported` E242 for a link without CANopen.
        """
        self._native = native.LssMaster(url, profile)
        self._url = url

    def __repr__(self) -> str:
        return f"<LssMaster of {self._url}>"

    def __enter__(self: _Self) -> _Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends LSS configuration and closes the bus."""
        self._native.close()

    def identity_of(self, node_id: int) -> LssIdentity:
        """The identity of a node, read from its object 1018h."""
        return LssIdentity(*self._native.identity_of(node_id))

    def node_answers(self, node_id: int) -> bool:
        """True if the node answers a read of its device type, 1000h."""
        return self._native.node_answers(node_id)

    def has_unconfigured(self) -> bool:
        """True if at least one device without node-ID is on the bus (service 4Ch)."""
        return self._native.has_unconfigured()

    def find_unconfigured(self) -> LssIdentity | None:
        """Finds one device without node-ID and brings it to LSS configuration (fast scan, service
        51h). The next call finds another one. None where no such device is left. Takes about 3.5 s.
        """
        found = self._native.find_unconfigured()
        return None if found is None else LssIdentity(*found)

    def select(self, identity: LssIdentity | tuple[int, int, int, int]) -> bool:
        """Brings one device to LSS configuration by its identity (services 40h to 43h). False where
        no device answers to it."""
        return self._native.select(*identity)

    def select_only_device(self) -> LssIdentity:
        """Brings the only device of the bus to LSS configuration without its identity (service 04h).

        Raises `Unsupported` E220 where several devices answer.
        """
        return LssIdentity(*self._native.select_only_device())

    def selected_identity(self) -> LssIdentity:
        """The identity of the device in LSS configuration (services 5Ah to 5Dh)."""
        return LssIdentity(*self._native.selected_identity())

    def node_id(self) -> int | None:
        """The node-ID of the device in LSS configuration (service 5Eh). None where it has none."""
        return self._native.node_id()

    def set_node_id(self, node_id: int | None) -> None:
        """Gives the device in LSS configuration a node-ID, 1 to 127, or takes it away (service 11h).

        A device that had none uses it when it leaves LSS configuration. Another one uses it after
        `restart_communication`.
        """
        self._native.set_node_id(node_id)

    def set_bit_rate(self, bit_per_s: int) -> None:
        """Gives the device in LSS configuration a bit rate of CiA 305, in bit/s (service 13h). It is
        used from the next start on, if it is stored.

        Raises `Unsupported` E216 for a rate that is not in the standard's table; nothing is sent.
        """
        self._native.set_bit_rate(bit_per_s)

    def store(self) -> None:
        """Stores node-ID and bit rate of the device in LSS configuration (service 17h)."""
        self._native.store()

    def leave_configuration(self) -> None:
        """Ends LSS configuration on all devices (service 04h)."""
        self._native.leave_configuration()

    def restart_communication(self, node_id: int) -> None:
        """Sends the NMT command reset communication to a node. Its motor stops. It uses its new
        node-ID from then on."""
        self._native.restart_communication(node_id)
