"""What tests share: drives in virtual time."""

from __future__ import annotations

from collections.abc import Iterator

import polepair
import pytest


@pytest.fixture
def link() -> Iterator[polepair.Link]:
    """A TMCM-171 in virtual time."""
    with polepair.connect("sim:tmcl?time=virtual") as opened:
        yield opened


@pytest.fixture
def axis(link: polepair.Link) -> polepair.Axis:
    """Its one axis."""
    return link.axes[0]
