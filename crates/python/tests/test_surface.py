"""Programs rely on the names of the package: `golden/surface.txt` pins them.

`POLEPAIR_GOLDEN=write pytest tests/test_surface.py` writes the file anew.
"""

from __future__ import annotations

import importlib
import inspect
import os
from pathlib import Path
from types import ModuleType

MODULES = ("polepair", "polepair._polepair", "polepair.aio", "polepair.can", "polepair.captures",
           "polepair.columns", "polepair.errors", "polepair.events", "polepair.explained",
           "polepair.fleet", "polepair.lss", "polepair.quantity", "polepair.testing", "polepair.trace")
PROTOCOLS = {"__enter__", "__exit__", "__aenter__", "__aexit__", "__iter__", "__next__", "__len__",
             "__getitem__"}
"""Special methods that programs use by syntax."""
GOLDEN = Path(__file__).parent / "golden" / "surface.txt"


def signature(thing: object) -> str:
    """Names, kinds and defaults of the parameters; nothing where there are none to be had."""
    try:
        found = inspect.signature(thing)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return ""
    plain = [
        parameter.replace(
            annotation=parameter.empty,
            default=parameter.default if isinstance(parameter.default, (type(None), int, float, str)) else ...
            if parameter.default is not parameter.empty
            else parameter.empty,
        )
        for parameter in found.parameters.values()
    ]
    return str(found.replace(parameters=plain, return_annotation=inspect.Signature.empty))


def members(name: str, thing: object) -> list[str]:
    """A line for a function or value, one for each member of a class of ours."""
    if not inspect.isclass(thing):
        return [name + signature(thing)]
    lines = [f"{name}({', '.join(base.__name__ for base in thing.__bases__)})"]
    for member in dir(thing):
        if member.startswith("_") and member not in PROTOCOLS:
            continue
        lines.append(f"{name}.{member}{signature(inspect.getattr_static(thing, member))}")
    return lines


def surface(module: ModuleType) -> list[str]:
    lines: list[str] = []
    names = getattr(module, "__all__", None) or [name for name in vars(module) if not name.startswith("_")]
    for name in sorted(names):
        thing = getattr(module, name)
        if isinstance(thing, ModuleType):
            continue
        if module.__name__ != "polepair" and not getattr(thing, "__module__", "").startswith("polepair"):
            continue
        lines += members(f"{module.__name__}.{name}", thing)
    return lines


def test_every_public_name_is_pinned() -> None:
    lines = [line for name in MODULES for line in surface(importlib.import_module(name))]
    if "POLEPAIR_GOLDEN" in os.environ:
        GOLDEN.write_text("\n".join(lines) + "\n")
    pinned = GOLDEN.read_text().splitlines()
    assert [line for line in pinned if line not in lines] == [], "gone"
    assert [line for line in lines if line not in pinned] == [], "new"
