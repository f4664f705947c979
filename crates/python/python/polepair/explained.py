"""Explanations of single frames and codes: `polepair.explain`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from . import _polepair as native
from ._records import Fault

__all__ = ["CanFrame", "Explained", "Meaning", "Part", "explain"]


class CanFrame(Protocol):
    """A CAN frame as python-can's `Message` has it."""

    arbitration_id: int
    is_extended_id: bool
    is_remote_frame: bool
    data: bytearray


@dataclass(frozen=True, slots=True)
class Part:
    """Some bytes of a frame, and their meaning."""

    start: int
    """First byte, counted from 0."""
    end: int
    """The byte after the last; `start` for a field of the CAN identifier."""
    name: str
    """The protocol's name for it."""
    value: Any
    """The value: int, float, str, or a list of 16-bit words."""
    meaning: str
    """The meaning of the value; empty if it has no name."""


@dataclass(frozen=True, slots=True)
class Explained:
    """The explanation of a frame."""

    bytes: bytes
    """The bytes."""
    kind: str
    """The protocol's word for it."""
    axis: int | None
    """The axis, station or module that it concerns."""
    text: str
    """The meaning in one line."""
    error: str | None
    """The violation of the protocol, or None."""
    parts: tuple[Part, ...]
    """The fields, in the order of their bytes."""

    @property
    def fields(self) -> dict[str, Any]:
        """The parts' values by name."""
        return {part.name: part.value for part in self.parts}

    def __str__(self) -> str:
        lines = [f"{self.kind}: {self.text}"]
        if self.error:
            lines.append(f"! {self.error}")
        for row in self._rows():
            lines.append("  ".join(f"{cell:<{width}}" for cell, width in row).rstrip())
        return "\n".join(lines)

    def _cells(self) -> list[tuple[str, str, str, str]]:
        return [
            (self.bytes[part.start : part.end].hex(" "), part.name, str(part.value), part.meaning)
            for part in self.parts
        ]

    def _rows(self) -> list[list[tuple[str, int]]]:
        cells = self._cells()
        widths = [max((len(row[at]) for row in cells), default=0) for at in range(4)]
        return [list(zip(row, widths, strict=True)) for row in cells]

    def _repr_html_(self) -> str:
        from ._html import table

        said = f"{self.kind}: {self.text}" + (f" ! {self.error}" if self.error else "")
        return table(["bytes", "field", "value", "meaning"], self._cells(), said)


@dataclass(frozen=True, slots=True)
class Meaning:
    """The explanation of a number."""

    code: int
    """The number."""
    text: str | None
    """As a status, an exception or an abort code of the protocol."""
    faults: tuple[tuple[str, Fault], ...]
    """As fault code or fault bits: the product, and its fault with cause and remedy."""

    def __str__(self) -> str:
        said = [self.text] if self.text else []
        said += [f"{product}: {fault}" for product, fault in self.faults]
        return f"{self.code} (0x{self.code:X}): {'; '.join(said) or 'unknown'}"


def explain(
    protocol: str,
    what: bytes | bytearray | str | int | CanFrame,
    *,
    id: int | None = None,
    extended: bool = False,
    to_drive: bool | None = None,
) -> Explained | Meaning:
    """Explains a frame byte by byte, or the meaning of a code. Nothing is sent.

    `protocol` is a protocol's word or a product's name. `what` is a frame: bytes (on CAN with `id`,
    and `extended` for 29 bits), a message of python-can, or text as captures have it, `30B#5443`; or
    a number: a status, an exception, fault bits. `to_drive` states the direction of the frame where its bytes
    do not show it. Errors: `Unsupported` E203 for a protocol, E241 for an unknown text.

    >>> import polepair
    >>> print(polepair.explain("tmcl", bytes.fromhex("01 06 01 00 00 00 00 00 08")).kind)
    GAP
    >>> polepair.explain("tmcl", 3).text
    'wrong type'
    """
    if isinstance(what, int):
        text, found = native.explain_code(protocol, what)
        return Meaning(what, text, tuple((product, Fault(*row)) for product, row in found))
    frame: str | tuple[bytes, int | None, bool, bool]
    if isinstance(what, str):
        frame = what
    elif isinstance(what, (bytes, bytearray)):
        frame = (bytes(what), id, extended, False)
    else:
        frame = (
            bytes(what.data), what.arbitration_id, what.is_extended_id, what.is_remote_frame,
        )
    data, kind, axis, said, error, parts = native.explain(protocol, frame, to_drive)
    return Explained(data, kind, axis, said, error, tuple(Part(*part) for part in parts))
