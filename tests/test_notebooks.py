"""Notebooks are jupytext pairs; `pytest --nbmake` executes them, this checks that they agree."""

from pathlib import Path

import jupytext
import pytest

_NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "notebooks").glob("*.py"))


@pytest.mark.parametrize("script", _NOTEBOOKS, ids=lambda path: path.stem)
def test_script_and_notebook_agree(script):
    notebook = script.with_suffix(".ipynb")
    assert notebook.exists(), f"{notebook.name} is missing: jupytext --sync {script.name}"
    cells = [
        [(cell.cell_type, cell.source) for cell in jupytext.read(path).cells]
        for path in (script, notebook)
    ]
    assert cells[0] == cells[1], f"run: jupytext --sync notebooks/{script.name}"
