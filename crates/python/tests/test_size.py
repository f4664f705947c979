"""The installed package is small, and nothing of it is loaded before it is needed."""

from __future__ import annotations

import subprocess
import sys
import zlib
from pathlib import Path

import polepair
import pytest

WHEEL_MAX = 15 << 20
"""Bytes of a wheel."""


def test_a_wheel_is_small() -> None:
    folder = Path(polepair.__file__).parent
    packed = 0
    for file in folder.rglob("*"):
        if file.suffix in {".so", ".pyd", ".py", ".pyi"}:
            content = file.read_bytes()
            if b".debug_info" in content:
                pytest.skip("a debug build: nobody makes a wheel of it")
            packed += len(zlib.compress(content, 6))
    assert 1 << 20 < packed < WHEEL_MAX


def test_nothing_is_imported_that_is_not_needed() -> None:
    heavy = ["asyncio", "can", "matplotlib", "numpy", "pandas", "polars", "pyarrow", "html"]
    program = f"import sys, polepair; print([name for name in {heavy} if name in sys.modules])"
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"


def test_no_annotation_is_compiled() -> None:
    program = """
import builtins, typing
compiled, own = [], builtins.compile
def compile(source, filename, *rest, **more):
    if filename == "<string>":
        compiled.append(source)
    return own(source, filename, *rest, **more)
builtins.compile = compile
import polepair
print(compiled)
"""
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"
