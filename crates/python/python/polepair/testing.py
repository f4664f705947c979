"""A pytest plugin: simulated drives for tests of your own motion code.

    def test_my_gantry(polepair_drives):
        link = polepair_drives("canopen:1,2", faults={"error": 1e-3})
        my_gantry.home(link)
        assert link.simulation.truth(drive=1).position < 0.01

Time is virtual: a minute of motion takes milliseconds. When a test fails, the last frames on the wire
are shown, explained.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Generator, Mapping
from pathlib import Path

import pytest

import polepair

from . import _polepair as native

__all__ = ["polepair_drives"]

SHOWN = 40
"""Frames that are shown of each link when a test fails."""

LINKS = pytest.StashKey[list[polepair.Link]]()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Shows the last frames of a test that failed."""
    report = yield
    if report.when == "call" and report.failed:
        for link in item.stash.get(LINKS, []):
            if lines := _explained(link):
                report.sections.append((f"Last frames of {link.url}", "\n".join(lines)))
    return report


@pytest.fixture
def polepair_drives(
    request: pytest.FixtureRequest, tmp_path: Path
) -> Generator[Callable[..., polepair.Link], None, None]:
    """Opens simulated drives: `polepair_drives("tmcl", seed=7, faults={"lose": 0.01})`.

    The first argument is the part after `sim:` of a connection string, or a rack file. `seed` decides
    all random values. `faults` are those of a rack file: chances of `flip`, `lose`, `duplicate`,
    `late` and others on a serial line, of `error`, `twice`, `lose` on a bus. Further keywords are
    keys of the connection string. Each link is closed when the test ends.
    """
    opened: list[polepair.Link] = []
    request.node.stash[LINKS] = opened

    def drives(
        what: str = "tmcl",
        *,
        seed: int = 0,
        faults: Mapping[str, float] | None = None,
        **keys: object,
    ) -> polepair.Link:
        if faults is not None:
            rack = tmp_path / f"rack{len(opened)}.toml"
            rack.write_text(_rack(what, faults))
            what = str(rack)
        options = {"time": "virtual", "seed": seed, **keys}
        text = "&".join(f"{key}={value}" for key, value in options.items())
        link = polepair.connect(f"sim:{what}?{text}", trace=True)
        opened.append(link)
        return link

    yield drives
    for link in opened:
        link.close()


def _rack(word: str, faults: Mapping[str, float]) -> str:
    """A rack file of one line with the drives that a word means, and with trouble."""
    can, protocol, drives = native.rack_of_word(word)
    lines = [
        "[[link]]",
        'name = "line"',
        f'kind = "{"can" if can else "serial"}"',
        f'protocol = "{protocol}"',
        "faults = { " + ", ".join(f"{key} = {chance}" for key, chance in faults.items()) + " }",
    ]
    for profile, address in drives:
        lines += ["[[link.drive]]", f'profile = "{profile}"']
        if address is not None:
            lines.append(f"address = {address}")
    return "\n".join(lines) + "\n"


def _explained(link: polepair.Link) -> list[str]:
    """The last frames, one a line."""
    try:
        lines = link.trace()[-SHOWN:]
        protocol = link.axes[0].protocol
    except (ValueError, IndexError):
        # The test has closed it.
        return []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "trace.log"
        file.write_text("\n".join(lines) + "\n")
        events = list(polepair.decode(file, protocols=protocol))
    first = next((event.time_ns for event in events if event.time_ns is not None), 0)
    return [
        f"{((event.time_ns or first) - first) / 1e9:10.6f} "
        f"{'>' if event.direction == 'tx' else '<'} "
        f"{event.bytes.hex(' '):24} {event.text}{' ! ' + event.error if event.error else ''}"
        for event in events
    ]
