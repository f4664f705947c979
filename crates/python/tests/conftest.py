"""Fixtures of the tests: drives in virtual time."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import polepair
import pytest

# Long enough time-outs for a machine that is busy with other things; programs that tests start inherit it.
# It holds for this whole process, and many tests wait for drives that are silent on purpose: no more than 3.
os.environ.setdefault("POLEPAIR_TIMEOUT_SCALE", "3")
# A shell ignores Ctrl+C in programs that it starts in the background, and they pass that on to theirs.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def link() -> Iterator[polepair.Link]:
    """A TMCM-171 in virtual time."""
    with polepair.connect("sim:tmcl?time=virtual") as opened:
        yield opened


@pytest.fixture
def axis(link: polepair.Link) -> polepair.Axis:
    """The one axis of the link."""
    return link.axes[0]
