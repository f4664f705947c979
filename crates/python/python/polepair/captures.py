"""Captures of buses: every frame explained."""

from __future__ import annotations

import os
from collections.abc import Iterator

from . import _polepair as native

__all__ = ["Capture", "decode"]


class Capture:
    """The frames of a capture, one after the other. Memory stays bounded however long it is."""

    __slots__ = ("_decoder",)

    def __init__(self, decoder: native.Decoder) -> None:
        self._decoder = decoder

    @property
    def verdicts(self) -> list[str]:
        """What each link speaks, and how sure that is; empty where `protocols` said so."""
        return self._decoder.verdicts

    @property
    def damage(self) -> list[str]:
        """Places that could not be read so far."""
        return self._decoder.damage

    def __iter__(self) -> Iterator[native.Event]:
        while events := self._decoder.read():
            yield from events


def decode(
    path: str | os.PathLike[str],
    *,
    protocols: str | None = None,
    profile: str | None = None,
    format: str | None = None,
) -> Capture:
    """Explains every frame of a capture file.

    `protocols` says who speaks, as the command line's `--as`: `canopen@2,thruster@11`. Without it
    the whole file is weighed first. `profile` is the product whose names are used.
    """
    return Capture(native.Decoder(path, protocols, profile, format))
