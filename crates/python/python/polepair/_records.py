"""What is told as a row of named values.

Annotations are evaluated here, not kept as text: `typing` would compile each text anew whenever the
package is imported.
"""

from typing import NamedTuple

__all__ = ["Fault", "Found", "Losses", "Reading", "State"]


class Fault(NamedTuple):
    """A fault or a warning that a drive reports, in the words of its profile."""

    code: int
    """The drive's code, or the bit in its flag word."""
    name: str
    """The manual's short name."""
    text: str
    """What happened."""
    cause: str
    """Why it usually happens."""
    remedy: str
    """What to do."""
    warning: bool
    """The drive goes on."""

    def __str__(self) -> str:
        return f"{self.name}: {self.text}"


class Reading(NamedTuple):
    """A signal's last value."""

    value: float
    """SI; NaN while a setting that the scale depends on was never read."""
    age: float
    """Seconds since it was read."""


class State(NamedTuple):
    """What is known of an axis without asking its drive."""

    mode: str | None
    """Mode of operation in words; None while not known, here and below."""
    enabled: bool | None
    """The motor is powered."""
    armed: bool
    """Motion commands are let through."""
    moving: bool | None
    """It moves."""
    readings: dict[str, Reading]
    """Every signal that was read. A server reads them all the time, a link when it is asked."""
    owner: str | None
    """Who commands it, by the server's word; None for nobody, and on a link of one's own."""


class Losses(NamedTuple):
    """What a wire noticed and could not hand on, since it was opened."""

    wire: str
    """Its name."""
    overrun: int
    """Frames or bytes that arrived and were thrown away because nobody took them in time."""
    malformed: int
    """What arrived and was no frame."""
    errors: int
    """Errors on the wire that a CAN controller reported."""
    refused: int
    """What the adapter would not send."""


class Found(NamedTuple):
    """A drive that answered a scan."""

    number: int
    """Its address."""
    product: str
    """The product's name, as profiles have it."""
    title: str
    """The product's full name."""
    known: str
    """How that is known."""
    clash: str | None
    """Set when two drives may have this address."""
