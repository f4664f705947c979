"""Errors, by their cause. All are subclasses of `PolepairError`."""

from __future__ import annotations

__all__ = [
    "DriveFault",
    "NoReply",
    "PolepairError",
    "ProtocolError",
    "Refused",
    "Unsupported",
]


class PolepairError(Exception):
    """An error of Polepair: `str()` is one sentence, notes have the remedy.

    `code` stays the same over versions (`E401`); `executed` is True or False where it is known
    whether the drive executed the request, and None if that is unknown.
    """

    code: str
    executed: bool | None
    hint: str

    def __init__(
        self, what: str, code: str = "E299", executed: bool | None = None, hint: str = ""
    ) -> None:
        super().__init__(what)
        self.code = code
        self.executed = executed
        self.hint = hint
        # Python 3.10 shows no notes; it keeps them all the same.
        self.__notes__ = [f"{hint[0].upper()}{hint[1:]}"] if hint else []

    def __reduce__(self) -> tuple[type[PolepairError], tuple[str, str, bool | None, str]]:
        return type(self), (str(self), self.code, self.executed, self.hint)


class NoReply(PolepairError):
    """No drive answered in time."""


class Refused(PolepairError):
    """The drive refused the request."""


class DriveFault(PolepairError):
    """The drive reports a fault."""


class ProtocolError(PolepairError):
    """The answer was corrupt, or to another question."""


class Unsupported(PolepairError):
    """It cannot be: nothing was sent."""
