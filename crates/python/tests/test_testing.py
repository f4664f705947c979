"""The pytest plugin, in test suites of its own."""

from __future__ import annotations

from collections.abc import Callable

import polepair
import pytest

Drives = Callable[..., polepair.Link]


def test_a_failed_test_shows_the_last_output(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        def test_reads(polepair_drives):
            axis = polepair_drives("tmcl:3").axis(3)
            assert axis.raw("GAP 1") == 4711

        def test_passes(polepair_drives):
            assert polepair_drives("cia402:1,2").axis(2).number == 2
        """
    )
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider")
    result.assert_outcomes(failed=1, passed=1)
    result.stdout.fnmatch_lines([
        "*Last frames of sim:tmcl:3*",
        "  0.0* > 03 06 01 00 00 00 00 00 0a*GAP 1, 0: read axis parameter *",
        "  0.0* < 02 03 64 06 00 00 00 00 6f*actual position = 0*",
    ])
    assert str(result.stdout).count("Last frames of") == 1
    assert not [*pytester.path.glob("*.log"), *pytester.path.glob(".polepair*")]


def test_each_link_that_was_opened_is_shown(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        def test_fails(polepair_drives):
            polepair_drives("tmcl").axes[0].raw("GAP 1")
            polepair_drives("cia402:1,2").axis(2).params["error register"]
            closed = polepair_drives("thruster")
            closed.close()
            assert False
        """
    )
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines([
        "*Last frames of sim:tmcl?*",
        "*Last frames of sim:cia402:1,2?*",
        "* < *",
    ])
    assert str(result.stdout).count("Last frames of") == 2


def test_several_drives_with_trouble_on_their_bus(polepair_drives: Drives) -> None:
    link = polepair_drives("cia402:1,2", seed=7, faults={"error": 1e-3})
    assert [axis.number for axis in link.axes] == [1, 2]
    for drive, axis in enumerate(link.axes):
        with axis.armed():
            axis.move(0.5 + drive).wait()
        assert link.simulation.truth(drive=drive).position == pytest.approx(0.5 + drive, abs=0.02)


@pytest.mark.parametrize("word", ["tmcl:1", "tmcl+can:1", "technocan:5", "syntron-ts-canopen:2"])
def test_a_lost_query_is_repeated(polepair_drives: Drives, word: str) -> None:
    def asked(faults: dict[str, float] | None) -> int:
        link = polepair_drives(word, seed=3, faults=faults, timeout=20)
        axis = link.axes[0]
        name = next(p for p in axis.params if axis.params.info(p).readable)
        for _ in range(60):
            axis.params.raw[name]
        line = [text.split() for text in link.trace()]
        return sum(words[2] == ">" or words[-1] == "T" for words in line)

    assert asked({"lose": 0.01}) > asked({}) == asked(None)


def test_the_same_seed_is_the_same_trouble(polepair_drives: Drives) -> None:
    def told(seed: int) -> list[str]:
        link = polepair_drives("tmcl", seed=seed, faults={"flip": 1e-3})
        for _ in range(50):
            link.axes[0].raw("GAP 1")
        return [line.split(maxsplit=2)[2] for line in link.trace()]

    assert told(1) == told(1) != told(2)


def test_an_unknown_word_is_refused(polepair_drives: Drives) -> None:
    with pytest.raises(polepair.Unsupported, match="tmcll"):
        polepair_drives("tmcll", faults={"lose": 0.1})
