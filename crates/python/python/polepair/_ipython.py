"""IPython and notebooks: Tab completes the names of parameters, signals and units of an axis.

IPython does not evaluate `axis.params` before a Tab, because a property may do anything. Those of this package
do not, so a matcher of ours evaluates them: names, attributes of our own objects, and numbers as indices.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, get_args

from .quantity import PositionUnit, TorqueUnit, VelocityUnit

if TYPE_CHECKING:
    from collections.abc import Iterable

TEXT = re.compile(
    r"""(?P<owner>[A-Za-z_]\w*(?:\.\w+|\[\d+\])*)\.(?P<member>\w+)"""
    r"""(?P<open>[(\[])(?P<before>[^()]*?)["'](?P<begun>[^"']*)$"""
)
"""A text that begins in a call or an index: `axis.read("po`, `link.axes[0].params["max c`."""

SIGNALS = ("read", "watch", "capture")
"""Methods with names of signals; all of them take parameters too."""
NAMES = ("read_text", "read_bytes", "write_bytes")
"""Methods with the name of a parameter."""
UNITS = {
    "move": PositionUnit,
    "move_by": PositionUnit,
    "spin": VelocityUnit,
    "torque": TorqueUnit,
}
"""Methods with a unit as their second argument."""
STEP_UNITS = {"position": PositionUnit, "velocity": VelocityUnit, "torque": TorqueUnit}
"""Units of the second argument of `step`."""


def _evaluate(owner: str, namespace: dict[str, Any]) -> Any:
    """The object of an expression; None if it is none of ours."""
    first, *rest = re.findall(r"\w+", owner)
    found = namespace.get(first)
    for part in rest:
        if isinstance(found, list | tuple | dict) and part.isdigit():
            found = found[int(part)]
        elif type(found).__module__.partition(".")[0] == "polepair":
            found = getattr(found, part)
        else:
            return None
    return found


def _candidates(axis: Any, member: str, opened: str, before: str) -> Iterable[str]:
    if opened == "[":
        return list(getattr(axis, member)) if member in ("params", "signals") else ()
    if member in SIGNALS:
        return [*axis.signals, *axis.params]
    if member in NAMES and not before.strip():
        return list(axis.params)
    if member in UNITS and before.count(",") == 1:
        return get_args(UNITS[member])
    if member == "step":
        of = re.match(r"""\s*["']([\w ]*)["']""", before)
        return STEP_UNITS if of is None else get_args(STEP_UNITS.get(of[1]))
    return ()


def completions(text: str, namespace: dict[str, Any]) -> tuple[str, list[str]]:
    """The begun name at the end of a text, and the names that complete it."""
    from ._axis import AxisSteps

    match = TEXT.search(text)
    if match is None:
        return "", []
    begun, member = match["begun"], match["member"]
    try:
        axis = _evaluate(match["owner"], namespace)
        if not isinstance(axis, AxisSteps):
            return begun, []
        found = _candidates(axis, member, match["open"], match["before"])
        return begun, [name for name in found if name.startswith(begun)]
    # Completion has no place for an error: a closed link has nothing to complete.
    except Exception:
        return begun, []


def load(shell: Any) -> None:
    """Adds the matcher to an IPython shell."""
    from IPython.core.completer import (  # type: ignore[import-not-found, unused-ignore]
        CompletionContext,
        SimpleCompletion,
        SimpleMatcherResult,
        context_matcher,
    )

    def polepair_names(context: CompletionContext) -> SimpleMatcherResult:
        begun, names = completions(context.text_until_cursor, shell.user_ns)
        return {
            "completions": [SimpleCompletion(text=name, type="param") for name in names],
            "matched_fragment": begun,
            "suppress": bool(names),
        }

    polepair_names = context_matcher(identifier="polepair")(polepair_names)
    shell.Completer.custom_matchers.append(polepair_names)
