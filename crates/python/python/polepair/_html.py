"""Notebook representations of objects."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape

__all__ = ["curves", "table"]

POINTS_MAX = 1200
"""Points of a curve; a screen shows no more."""


def table(heads: Sequence[str], rows: Iterable[Sequence[object]], caption: str = "") -> str:
    """A table; everything in it is text."""
    head = "".join(f"<th>{escape(name)}</th>" for name in heads)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows
    )
    said = f"<caption>{escape(caption)}</caption>" if caption else ""
    heading = f"<thead><tr>{head}</tr></thead>" if any(heads) else ""
    return f"<table>{said}{heading}<tbody>{body}</tbody></table>"


def curves(
    times: Sequence[float], columns: Mapping[str, Sequence[float]], caption: str = ""
) -> str:
    """Signals over time, each in a strip of its own with its least and greatest value."""
    strips = "".join(_strip(times, name, values) for name, values in columns.items())
    return f"<figure><figcaption>{escape(caption)}</figcaption>{strips}</figure>"


def _strip(times: Sequence[float], name: str, values: Sequence[float]) -> str:
    if not values:
        return ""
    low, high = min(values), max(values)
    span, height = (times[-1] - times[0]) or 1.0, (high - low) or 1.0
    every = max(1, len(values) // POINTS_MAX)
    points = " ".join(
        f"{(time - times[0]) / span * 600:.1f},{74 - (value - low) / height * 68:.1f}"
        for time, value in list(zip(times, values, strict=True))[::every]
    )
    said = f"{escape(name)}: {low:.4g} to {high:.4g}, {span:.4g} s"
    return (
        f'<div>{said}<br><svg width="600" height="80" role="img" aria-label="{said}">'
        f'<polyline points="{points}" fill="none" stroke="#1f77b4" stroke-width="1.5"/></svg></div>'
    )
