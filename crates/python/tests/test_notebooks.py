"""The notebooks in `docs/notebooks` run, and show what is shown in them.

`POLEPAIR_NOTEBOOKS=write` writes what they show now: look at the pictures before you commit them.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[3] / "docs" / "notebooks").glob("*.ipynb"))


def texts(cell: Any) -> list[str]:
    """Output of a cell without pictures: their bytes change with each matplotlib."""
    return [
        str(output.get("text") or output["data"].get("text/plain"))
        for output in cell.get("outputs", [])
        if "image/png" not in output.get("data", {})
    ]


def pictures(cell: Any) -> int:
    return sum("image/png" in output.get("data", {}) for output in cell.get("outputs", []))


def test_there_are_three() -> None:
    assert [path.stem for path in NOTEBOOKS] == ["bring-up", "find-a-fault", "many-machines"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_shows_the_same_as_before(path: Path) -> None:
    kept = nbformat.read(path, as_version=4)
    ran = nbformat.read(path, as_version=4)
    # The kernel sends the output of a cell in any number of pieces: here they are one text.
    where = {"metadata": {"path": str(path.parent)}}
    NotebookClient(ran, timeout=300, resources=where, coalesce_streams=True).execute()
    if os.environ.get("POLEPAIR_NOTEBOOKS") == "write":
        for cell in ran.cells:
            # When a cell ran says nothing to who reads it.
            cell.metadata.pop("execution", None)
        ran.metadata.pop("language_info", None)
        nbformat.write(ran, path)
        return
    for before, now in zip(kept.cells, ran.cells, strict=True):
        assert texts(now) == texts(before), now.source
        assert pictures(now) == pictures(before), now.source
    assert sum(map(pictures, kept.cells)) >= 2
