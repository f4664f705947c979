"""Step responses, against second-order systems that are known exactly."""

from __future__ import annotations

import math
from pathlib import Path

import polepair
import pytest


def response(zeta: float, omega: float, time: float) -> float:
    """A second-order system's answer to a unit step at time 0."""
    if time <= 0:
        return 0.0
    damped = omega * math.sqrt(1 - zeta**2)
    swing = math.cos(damped * time) + zeta / math.sqrt(1 - zeta**2) * math.sin(damped * time)
    return 1 - math.exp(-zeta * omega * time) * swing


def crossing(zeta: float, omega: float, level: float) -> float:
    """When it first comes up to a level, by bisection up to its peak."""
    low, high = 0.0, math.pi / (omega * math.sqrt(1 - zeta**2))
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if response(zeta, omega, middle) < level else (low, middle)
    return low


def settled(zeta: float, omega: float, band: float) -> float:
    """When it is last outside of the band: between two extremes, by bisection."""
    half = math.pi / (omega * math.sqrt(1 - zeta**2))
    last = 0
    while abs(response(zeta, omega, (last + 1) * half) - 1) > band:
        last += 1
    low, high = last * half, (last + 1) * half
    for _ in range(80):
        middle = (low + high) / 2
        outside = abs(response(zeta, omega, middle) - 1) > band
        low, high = (middle, high) if outside else (low, middle)
    return low


@pytest.mark.parametrize("zeta", [0.2, 0.3, 0.5, 0.7, 0.9])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_metrics_are_those_of_the_textbook(zeta: float, direction: float) -> None:
    omega, rate, base, way = 20.0, 4000, 3.0, 10.0 * direction
    times = [at / rate for at in range(-40, int(rate * 14 / (zeta * omega)))]
    values = [base + way * response(zeta, omega, time) for time in times]
    trace = polepair.Trace("plant", times, {"velocity": values})
    step = trace.step("velocity", base + way, at=0.0)
    peak_time = math.pi / (omega * math.sqrt(1 - zeta**2))
    overshoot = math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2))
    rise = crossing(zeta, omega, 0.9) - crossing(zeta, omega, 0.1)
    assert step.initial == pytest.approx(base)
    assert step.final == pytest.approx(base + way, abs=1e-3)
    assert step.error == pytest.approx(0, abs=1e-3)
    assert step.overshoot == pytest.approx(overshoot, abs=2e-4)
    assert step.peak_time == pytest.approx(peak_time, abs=1 / rate)
    assert step.peak == pytest.approx(base + way * (1 + overshoot), abs=2e-3)
    assert step.rise == pytest.approx(rise, rel=2e-3)
    assert step.delay == pytest.approx(crossing(zeta, omega, 0.5), rel=2e-3)
    assert step.settling == pytest.approx(settled(zeta, omega, 0.02), rel=2e-3)
    wide = trace.step("velocity", at=0.0, band=0.05)
    assert wide.settling == pytest.approx(settled(zeta, omega, 0.05), rel=2e-3)


def test_a_signal_that_ends_beside_its_target_has_an_error() -> None:
    times = [at / 100 for at in range(400)]
    values = [8.0 * (1 - math.exp(-time / 0.2)) for time in times]
    step = polepair.Trace("plant", times, {"v": values}).step("v", 10.0)
    assert step.error == pytest.approx(2.0, abs=1e-3)
    assert step.overshoot < 1e-6
    # A first-order lag: rise is tau ln 9, settling to 2 % tau ln 50.
    assert step.rise == pytest.approx(0.2 * math.log(9), rel=0.01)
    assert step.settling == pytest.approx(0.2 * math.log(50), rel=0.01)


def test_a_value_that_is_no_step_is_refused() -> None:
    still = polepair.Trace("plant", [0.0, 1.0, 2.0], {"v": [1.0, 1.0, 1.0]})
    with pytest.raises(ValueError, match="did not move"):
        still.step("v")
    with pytest.raises(ValueError, match="too few"):
        polepair.Trace("plant", [0.0], {"v": [1.0]}).step("v")
    swinging = [math.sin(at) + (0.01 * at) for at in range(100)]
    trace = polepair.Trace("plant", [float(at) for at in range(100)], {"v": swinging})
    assert math.isnan(trace.step("v").settling)


def test_an_axis_takes_a_step(axis: polepair.Axis, link: polepair.Link) -> None:
    with axis.armed():
        step = axis.step("velocity", 120, "rpm", rate=200, seconds=2.0)
    assert step.target == pytest.approx(4 * math.pi)
    assert step.initial == pytest.approx(0, abs=0.1)
    assert abs(step.error) < 0.05 * step.target
    assert 0 < step.rise < 1.0 and 0 < step.delay < 1.0
    assert "rise" in str(step) and "<svg" in step._repr_html_()
    assert step.unit == "rad/s" and str(step).endswith(" rad/s")
    assert "velocity [rad/s]" in step._repr_html_()
    with pytest.raises(polepair.Unsupported):
        axis.step("supply voltage", 1)


def test_a_step_is_drawn(tmp_path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    times = [at / 1000 for at in range(-20, 1500)]
    values = [100 * response(0.3, 20.0, time) for time in times]
    trace = polepair.Trace("axis 1", times, {"velocity": values}, {"velocity": "rad/s"})
    step = trace.step("velocity", 100.0, at=0.0)
    drawn = step.plot()
    assert drawn.get_ylabel() == "velocity [rad/s]"
    legend = trace.plot().get_legend().get_texts()
    assert [text.get_text() for text in legend] == ["velocity [rad/s]"]
    labels = [text.get_text() for text in drawn.get_legend().get_texts()]
    assert any(label.startswith("rise ") for label in labels)
    assert "overshoot 37.2%" in labels
    file = tmp_path / "step.png"
    drawn.figure.savefig(file)
    assert file.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n" and file.stat().st_size > 10_000
