"""Notebooks are jupytext pairs that agree and run; the long ones run in the slow tier."""

from pathlib import Path

import jupytext
import pytest
from nbclient import NotebookClient

_NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "notebooks").glob("*.py"))
_QUICK = {"01_light_fields"}


def test_there_are_notebooks():
    assert {path.stem for path in _NOTEBOOKS} >= _QUICK


@pytest.mark.parametrize("script", _NOTEBOOKS, ids=lambda path: path.stem)
def test_script_and_notebook_agree(script):
    notebook = script.with_suffix(".ipynb")
    assert notebook.exists(), f"{notebook.name} is missing: jupytext --sync {script.name}"
    cells = [
        [(cell.cell_type, cell.source) for cell in jupytext.read(path).cells]
        for path in (script, notebook)
    ]
    assert cells[0] == cells[1], f"run: jupytext --sync notebooks/{script.name}"


@pytest.mark.filterwarnings("ignore")  # of the kernel's own machinery
@pytest.mark.parametrize(
    "script",
    [
        pytest.param(path, id=path.stem, marks=[] if path.stem in _QUICK else [pytest.mark.slow])
        for path in _NOTEBOOKS
    ],
)
def test_notebook_runs(script, tmp_path):
    notebook = jupytext.read(script)
    client = NotebookClient(notebook, timeout=600, kernel_name="python3")
    client.execute(cwd=str(tmp_path))
