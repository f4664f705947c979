"""Values with units, and the words of units and signals."""

from __future__ import annotations

from typing import Literal, TypeAlias, Union

__all__ = ["Amount", "PositionUnit", "Quantity", "Signal", "TorqueUnit", "VelocityUnit"]

PositionUnit: TypeAlias = Literal[
    "rad", "deg", "degrees", "°", "turn", "turns", "rev", "m", "cm", "mm", "um", "µm"
]
"""Units of positions and distances: of rotation, or of linear motion."""

VelocityUnit: TypeAlias = Literal["rad/s", "deg/s", "turn/s", "rpm", "m/s", "mm/s"]
"""Units of velocities: of rotation, or of linear motion."""

TorqueUnit: TypeAlias = Literal["Nm", "N·m", "N*m", "mNm", "Ncm"]
"""Units of torques."""

Signal: TypeAlias = Literal[
    "position",
    "velocity",
    "torque",
    "current",
    "voltage",
    "temperature",
    "target position",
    "target velocity",
    "fault",
    "enabled",
    "moving",
    "reached",
    "mode",
    "time",
    "positive limit",
    "negative limit",
]
"""Signals of drives. `Axis.signals` has those of one axis."""


class Quantity(float):
    """A number that knows its unit, the drive's raw value, and its word where it has one.

    >>> from polepair import Quantity
    >>> current = Quantity(1.2, "A", raw=120)
    >>> current, current * 2, current.raw
    (1.2 A, 2.4, 120)
    """

    __slots__ = ("raw", "text", "unit", "word")

    unit: str
    """Symbol of the unit; empty for none."""
    raw: int | None
    """Raw number of the drive."""
    word: str | None
    """Name of the value in the manual, if it has one."""
    text: str
    """Text with the digits that the drive has, and the unit."""

    def __new__(
        cls,
        value: float,
        unit: str = "",
        *,
        raw: int | None = None,
        word: str | None = None,
        text: str | None = None,
    ) -> Quantity:
        made = super().__new__(cls, value)
        made.unit = unit
        made.raw = raw
        made.word = word
        made.text = text if text is not None else f"{value:g} {unit}".rstrip()
        return made

    def __repr__(self) -> str:
        return self.text

    __str__ = __repr__

    def _repr_html_(self) -> str:
        from html import escape

        word = f" ({escape(self.word)})" if self.word else ""
        raw = "" if self.raw is None else f' title="raw {self.raw}"'
        return f"<span{raw}><b>{escape(self.text)}</b>{word}</span>"

    def __reduce__(self) -> tuple[object, ...]:
        return _make, (float(self), self.unit, self.raw, self.word, self.text)


def _make(value: float, unit: str, raw: int | None, word: str | None, text: str) -> Quantity:
    return Quantity(value, unit, raw=raw, word=word, text=text)


Amount: TypeAlias = Union[float, str, tuple[float, str]]  # noqa: UP007
"""An argument with or without a unit: a number, `"60 rpm"`, or `(60, "rpm")`."""


def given(amount: Amount | None, unit: str | None = None) -> float | str | None:
    """An amount as the native module takes it."""
    if isinstance(amount, tuple):
        amount, unit = amount
    if amount is None or isinstance(amount, str):
        return amount
    if unit is None and isinstance(amount, Quantity) and amount.unit:
        unit = amount.unit
    # The shortest decimal that is this number: what is read back is what was written.
    return float(amount) if unit is None else f"{float(amount)!r} {unit}"
