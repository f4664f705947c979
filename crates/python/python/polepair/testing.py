"""A pytest plugin: simulated drives for tests of your own motion code.

    def test_my_gantry(polepair_drives):
        link = polepair_drives("canopen:1,2", faults={"error": 1e-3})
        my_gantry.home(link)
        assert link.simulation.truth(drive=1).position < 0.01

Time is virtual: a minute of motion takes milliseconds. When a test fails, the last frames on the wire
are shown, explained.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from typing import Any

import pytest

import polepair

__all__ = ["polepair_drives"]

SHOWN = 40
"""Frames that are shown of each link when a test fails."""




@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Shows the last frames of a test that failed."""
    report = yield
    if report.when == "call" and report.failed:
        links: list[polepair.Link] = item.stash.get(LINKS, [])
        for link in links:
            if lines := _explained(link, item):
                report.sections.append((f"Last frames of {link.url}", "\n".join(lines)))
    return report


LINKS = pytest.StashKey[list[polepair.Link]]()


@pytest.fixture
def polepair_drives(
    request: pytest.FixtureRequest, tmp_path: Path
) -> Generator[Callable[..., polepair.Link], None, None]:
    """Opens simulated drives: `polepair_drives("tmcl", seed=7, faults={"lose": 0.01})`.

    The first argument is what follows `sim:` in a connection string, or a rack file. `seed` decides
    whatever is random. `faults` are those of a rack file: chances of `flip`, `lose`, `duplicate`,
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
            what = _rack(tmp_path, len(opened), what, faults)
        options = {"time": "virtual", "seed": seed, **keys}
        text = "&".join(f"{key}={value}" for key, value in options.items())
        link = polepair.connect(f"sim:{what}?{text}", trace=True)
        opened.append(link)
        return link

    yield drives
    for link in opened:
        link.close()


def _rack(folder: Path, number: int, what: str, faults: Mapping[str, float]) -> str:
    """A rack file of one line with drives on it, and with trouble."""
    word, _, addresses = what.partition(":")
    can = word.endswith("+can") or word in {
        "canopen", "cia402", "thruster", "thruster-servo", "thruster-actuator", "tmlcan",
        "technocan", "syntron-ts-canopen",
    }
    lines = ["[[link]]", 'name = "line"', f'kind = "{"can" if can else "serial"}"']
    named = {name: title for name, title, _ in polepair.profiles()}
    protocol = word.removesuffix("+can")
    if protocol not in named:
        lines.append(f'protocol = "{protocol}"')
    lines.append("faults = { " + ", ".join(f"{k} = {v}" for k, v in faults.items()) + " }")
    for address in addresses.split(",") if addresses else [""]:
        lines.append("[[link.drive]]")
        if protocol in named:
            lines.append(f'profile = "{protocol}"')
        if address:
            lines.append(f"address = {address}")
    file = folder / f"rack{number}.toml"
    file.write_text("\n".join(lines) + "\n")
    return str(file)


def _explained(link: polepair.Link, item: pytest.Item) -> list[str]:
    """The last frames, one a line."""
    try:
        lines = link.trace()[-SHOWN:]
        axis = link.axes[0]
    except (ValueError, IndexError):
        return []
    file = Path(str(item.config.rootpath)) / ".polepair-trace.log"
    try:
        file.write_text("\n".join(lines) + "\n")
        events: list[Any] = list(polepair.decode(file, protocols=axis.protocol))
    finally:
        file.unlink(missing_ok=True)
    times = [event.time_ns or 0 for event in events]
    first = times[0] if times else 0
    return [
        f"{(time - first) / 1e9:10.6f} {'>' if event.direction == 'tx' else '<'} "
        f"{event.bytes.hex(' '):24} {event.text}{' ! ' + event.error if event.error else ''}"
        for time, event in zip(times, events, strict=True)
    ]
