"""What signals did over a while, and how good a step response was."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

__all__ = ["Step", "Trace"]


@dataclass(frozen=True, slots=True)
class Step:
    """How a signal followed a step."""

    rise: float
    """Seconds from 10 % to 90 % of the way."""
    overshoot: float
    """How far beyond the end it went, as a share of the way."""
    settling: float
    """Seconds until it stayed within 2 % of the way around the end."""
    final: float
    """Where it ended."""


@dataclass(frozen=True, slots=True)
class Trace:
    """Samples of an axis' signals, in SI, each row with its time in seconds."""

    axis: str
    times: list[float]
    columns: dict[str, list[float]]

    def __len__(self) -> int:
        return len(self.times)

    def __getitem__(self, signal: str) -> list[float]:
        return self.columns[signal]

    def step(self, signal: str, target: float | None = None) -> Step:
        """Judges a signal as the answer to a step from its first value to `target`, or its last.

        >>> from polepair import Trace
        >>> rising = Trace("axis", [0.0, 1.0, 2.0, 3.0, 4.0], {"v": [0.0, 0.5, 1.1, 1.0, 1.0]})
        >>> rising.step("v").overshoot
        0.1
        """
        values = self.columns[signal]
        first, final = values[0], values[-1] if target is None else target
        way = final - first
        if not way:
            raise ValueError(f"`{signal}` did not move")
        shares = [(value - first) / way for value in values]

        def crossed(level: float) -> float:
            for at, share in enumerate(shares):
                if share >= level:
                    return self.times[at]
            return float("nan")

        outside = [time for time, share in zip(self.times, shares, strict=True)
                   if abs(share - 1.0) > 0.02]
        settled = outside[-1] - self.times[0] if outside else 0.0
        over = round(max(0.0, max(shares) - 1.0), 12)
        return Step(crossed(0.9) - crossed(0.1), over, settled, values[-1])

    def to_numpy(self) -> dict[str, Any]:
        """`time` and every signal as an array of float64."""
        import numpy as np

        arrays = {"time": np.asarray(self.times)}
        return arrays | {name: np.asarray(values) for name, values in self.columns.items()}

    def plot(self, axes: Any = None) -> Any:
        """Draws every signal over time, into `axes` if given; needs `polepair[plot]`."""
        import matplotlib.pyplot as plt

        drawn = axes if axes is not None else plt.subplots()[1]
        for name, values in self.columns.items():
            drawn.plot(self.times, values, label=name)
        drawn.set_xlabel("time [s]")
        drawn.set_title(self.axis)
        drawn.legend()
        return drawn
