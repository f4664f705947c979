"""Records: rows of named values.

Annotations are evaluated here, not kept as text: `typing` would compile each text anew whenever the
package is imported.
"""

from typing import NamedTuple

__all__ = ["Fault", "Found", "Losses", "Reading", "State"]


class Fault(NamedTuple):
    """A fault or warning of a drive, with the texts of its profile."""

    code: int
    """The drive's code, or the bit in its flag word."""
    name: str
    """The manual's short name."""
    text: str
    """The meaning of the fault."""
    cause: str
    """Why it usually happens."""
    remedy: str
    """A remedy."""
    warning: bool
    """True if the drive continues to work."""

    def __str__(self) -> str:
        return f"{self.name}: {self.text}"


class Reading(NamedTuple):
    """A signal's last value."""

    value: float
    """Value in SI; NaN until the settings of its scale are read."""
    age: float
    """Seconds since it was read."""


class State(NamedTuple):
    """The known state of an axis, without a request to the drive."""

    mode: str | None
    """Operation mode; None while unknown, here and below."""
    enabled: bool | None
    """The motor is powered."""
    armed: bool
    """Motion commands are allowed."""
    moving: bool | None
    """It moves."""
    readings: dict[str, Reading]
    """All signals that were read. A server reads them continuously, a link on request."""
    owner: str | None
    """The client with the lease; None if there is none, and on a local link."""


class Losses(NamedTuple):
    """Losses and errors of a wire since it was opened."""

    wire: str
    """The name."""
    overrun: int
    """Frames or bytes that were dropped because they were not read in time."""
    malformed: int
    """Received data that were not frames."""
    errors: int
    """Errors on the wire that a CAN controller reported."""
    refused: int
    """Frames that the adapter did not send."""


class Found(NamedTuple):
    """A drive that answered a scan."""

    number: int
    """The address."""
    product: str
    """Name of the product in profiles."""
    title: str
    """The product's full name."""
    known: str
    """Source of this identification."""
    clash: str | None
    """Set when two drives may have this address."""
