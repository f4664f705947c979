"""Recorded signals, and metrics of a step response."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from .columns import extra

if TYPE_CHECKING:
    import pandas
    import polars
    import pyarrow

__all__ = ["StepResponse", "Trace"]

TAIL = 0.1
"""The share of a trace at its end whose mean counts as where the signal ended."""


@dataclass(frozen=True, slots=True)
class StepResponse:
    """Metrics of a step response.

    Shares are of the change from the initial to the final value, as control engineers count: a signal
    that ends beside its target has a steady-state error, not an endless settling. Times are seconds
    after the step; between samples the signal is interpolated linearly. A metric that the trace does not reach
    is NaN.
    """

    signal: str
    """Name of the signal."""
    target: float
    """Where it should have gone."""
    initial: float
    """Where it was."""
    final: float
    """Where it ended: the mean of the last tenth of the samples."""
    rise: float
    """From 10 % to 90 % of the way."""
    delay: float
    """Until it had gone half of the way."""
    overshoot: float
    """Overshoot beyond the end, as a share of the step."""
    peak: float
    """Peak value in the direction of the step."""
    peak_time: float
    """Time of the peak."""
    settling: float
    """Until it stayed within `band` of the way around the end."""
    error: float
    """Steady-state error: target less final."""
    band: float
    """The band of `settling`, as a share of the way."""
    times: tuple[float, ...]
    """Times of the samples, from the step on."""
    values: tuple[float, ...]
    """Values of the samples."""
    unit: str = ""
    """The unit of target, values, peak and error; empty if unknown."""

    def __str__(self) -> str:
        error = f"{self.error:.4g} {self.unit}".rstrip()
        return (
            f"{self.signal}: rise {self.rise * 1e3:.4g} ms, overshoot {self.overshoot:.1%}, "
            f"settling ({self.band:.0%}) {self.settling * 1e3:.4g} ms, error {error}"
        )

    def __repr__(self) -> str:
        return f"<StepResponse {self}>"

    def _repr_html_(self) -> str:
        from ._html import curves, table

        units = dict.fromkeys(("target", "final", "error", "peak"), self.unit)
        units |= dict.fromkeys(("rise", "delay", "peak_time", "settling"), "s")
        rows = [
            (name, f"{getattr(self, name):.6g} {units.get(name, '')}".rstrip())
            for name in (
                "target", "final", "error", "rise", "delay", "overshoot", "peak", "peak_time",
                "settling",
            )
        ]
        called = _called(self.signal, self.unit)
        return curves(self.times, {called: self.values}) + table(["", self.signal], rows)

    def plot(self, axes: Any = None) -> Any:
        """Draws it with its target, band, rise and peak; needs `polepair[plot]`."""
        pyplot = extra("matplotlib.pyplot", "polepair[plot]")
        drawn = axes if axes is not None else pyplot.subplots(layout="constrained")[1]
        way = self.final - self.initial
        low, high = sorted((self.final - self.band * way, self.final + self.band * way))
        drawn.axhspan(low, high, color="tab:green", alpha=0.15, label=f"±{self.band:.0%}")
        drawn.axhline(self.target, color="0.4", linestyle="--", linewidth=1, label="target")
        drawn.plot(self.times, self.values, color="tab:blue", label=self.signal)
        begins = _crossed(self.times, self._shares(), 0.1)
        if not math.isnan(self.rise):
            drawn.axvspan(begins, begins + self.rise, color="tab:orange", alpha=0.15,
                          label=f"rise {self.rise * 1e3:.3g} ms")
        if self.overshoot > 0:
            drawn.plot([self.peak_time], [self.peak], "o", color="tab:red",
                       label=f"overshoot {self.overshoot:.1%}")
        if not math.isnan(self.settling):
            drawn.axvline(self.settling, color="tab:green", linewidth=1,
                          label=f"settled {self.settling * 1e3:.3g} ms")
        drawn.set_xlabel("time since the step [s]")
        drawn.set_ylabel(_called(self.signal, self.unit))
        drawn.set_title(f"Step response: {self.signal}")
        drawn.grid(alpha=0.3)
        drawn.legend(loc="lower right")
        return drawn

    def _shares(self) -> list[float]:
        return [(value - self.initial) / (self.final - self.initial) for value in self.values]


@dataclass(frozen=True, slots=True)
class Trace:
    """Samples of an axis' signals, in SI, each row with its time in seconds."""

    axis: str
    """Label of the axis."""
    times: list[float]
    """Time of each row; 0 is the start, or the time of the step."""
    columns: dict[str, list[float]]
    """Every signal's values, a row each."""
    units: dict[str, str] = field(default_factory=dict)
    """Unit of each signal; a signal without an entry has no known unit."""

    def __len__(self) -> int:
        return len(self.times)

    def __getitem__(self, signal: str) -> list[float]:
        return self.columns[signal]

    def __repr__(self) -> str:
        span = f"{self.times[-1] - self.times[0]:.3g} s" if self.times else "empty"
        return f"<Trace of {self.axis}: {', '.join(self.columns)}; {len(self)} rows, {span}>"

    def _repr_html_(self) -> str:
        from ._html import curves

        called = {_called(name, self.units.get(name, "")): v for name, v in self.columns.items()}
        return curves(self.times, called, self.axis)

    def step(
        self,
        signal: str,
        target: float | None = None,
        *,
        at: float | None = None,
        band: float = 0.02,
    ) -> StepResponse:
        """Evaluates a signal as response to a step to `target` (default: the end value) at the time `at`
        (default: that of the first sample). `band` is the tolerance of settling.

        Errors: ValueError for a signal that did not move, or has fewer than three samples.

        >>> from polepair import Trace
        >>> rising = Trace("axis", [0.0, 1.0, 2.0, 3.0, 4.0], {"v": [0.0, 0.5, 1.1, 1.0, 1.0]})
        >>> step = rising.step("v")
        >>> round(step.overshoot, 3), round(step.delay, 3)
        (0.1, 1.0)
        """
        values = self.columns[signal]
        if len(values) < 3:
            raise ValueError(f"`{signal}` has {len(values)} samples: too few for a step")
        began = self.times[0] if at is None else at
        times = [time - began for time in self.times]
        initial = _at(times, values, 0.0)
        tail = values[-max(1, round(len(values) * TAIL)):]
        final = math.fsum(tail) / len(tail)
        way = final - initial
        if not way:
            raise ValueError(f"`{signal}` did not move")
        after = [at for at, time in enumerate(times) if time >= 0.0]
        shares = [(value - initial) / way for value in values]
        top = max(after, key=shares.__getitem__, default=0)
        return StepResponse(
            signal=signal,
            target=final if target is None else target,
            initial=initial,
            final=final,
            rise=_crossed(times, shares, 0.9) - _crossed(times, shares, 0.1),
            delay=_crossed(times, shares, 0.5),
            overshoot=max(0.0, shares[top] - 1.0),
            peak=values[top],
            peak_time=times[top],
            settling=_settled(times, shares, band),
            error=(final if target is None else target) - final,
            band=band,
            times=tuple(times),
            values=tuple(values),
            unit=self.units.get(signal, ""),
        )

    def _table(self) -> dict[str, list[float]]:
        return {"time": self.times} | self.columns

    def to_numpy(self) -> dict[str, Any]:
        """`time` and every signal as an array of float64; needs NumPy."""
        np = extra("numpy", "numpy")
        return {name: np.asarray(values) for name, values in self._table().items()}

    def to_arrow(self) -> pyarrow.Table:
        """`time` and every signal as pyarrow has it; needs `polepair[arrow]`."""
        made: pyarrow.Table = extra("pyarrow", "polepair[arrow]").table(self._table())
        return made

    def to_pandas(self) -> pandas.DataFrame:
        """Every signal as a column of a pandas data frame, by time; needs pandas."""
        made: pandas.DataFrame = extra("pandas", "pandas").DataFrame(self._table())
        return made.set_index("time")

    def to_polars(self) -> polars.DataFrame:
        """`time` and every signal as a Polars data frame; needs Polars."""
        made: polars.DataFrame = extra("polars", "polars").DataFrame(self._table())
        return made

    def plot(self, axes: Any = None) -> Any:
        """Draws every signal over time, into `axes` if given; needs `polepair[plot]`."""
        pyplot = extra("matplotlib.pyplot", "polepair[plot]")
        drawn = axes if axes is not None else pyplot.subplots(layout="constrained")[1]
        for name, values in self.columns.items():
            drawn.plot(self.times, values, label=_called(name, self.units.get(name, "")))
        drawn.set_xlabel("time [s]")
        drawn.set_title(self.axis)
        drawn.grid(alpha=0.3)
        drawn.legend()
        return drawn


def _called(signal: str, unit: str) -> str:
    """A signal as axes and legends name it: `velocity [rad/s]`."""
    return f"{signal} [{unit}]" if unit else signal


def _at(times: Sequence[float], values: Sequence[float], when: float) -> float:
    """The value at a time, straight between samples."""
    for before, (time, value) in enumerate(zip(times[1:], values[1:], strict=True)):
        if time >= when:
            earlier = times[before]
            share = (when - earlier) / (time - earlier) if time > earlier else 1.0
            return values[before] + (value - values[before]) * max(0.0, share)
    return values[0]


def _crossed(times: Sequence[float], shares: Sequence[float], level: float) -> float:
    """Time at which the signal first reached a level after the step."""
    for before, share in enumerate(shares[1:]):
        time, earlier = times[before + 1], times[before]
        if time >= 0.0 and share >= level:
            low = shares[before]
            if low >= level:
                return max(earlier, 0.0)
            return max(0.0, earlier + (time - earlier) * (level - low) / (share - low))
    return math.nan


def _settled(times: Sequence[float], shares: Sequence[float], band: float) -> float:
    """Time from which the signal stays in the band; NaN if only the last sample is in it."""
    for before in range(len(shares) - 1, -1, -1):
        beyond = shares[before] - 1.0
        if abs(beyond) > band:
            if before + 2 > len(shares) - 1:
                return math.nan
            edge = 1.0 + math.copysign(band, beyond)
            share = (edge - shares[before]) / (shares[before + 1] - shares[before])
            return max(0.0, times[before] + (times[before + 1] - times[before]) * share)
    return 0.0
