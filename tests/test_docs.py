"""Pages name what is there: the table of equations, and code that runs."""

import importlib
import inspect
import re
from pathlib import Path

import jax
import numpy as np
import pytest

import mvedge_jax

_PACKAGE = Path(mvedge_jax.__file__).parent
_PAGE = Path(__file__).parents[1] / "docs" / "equations.md"


_EXPERIMENTS = _PACKAGE.parent / "experiments"
# What the thesis numbers, by chapter: how many of each.
_NUMBERS = {
    "Eq.": {"4": 11, "5": 4, "6": 10, "7": 16},
    "Alg.": {"": 2},
    "Tab.": {"6": 3, "7": 2, "C": 1},
    "Fig.": {**{"1": 2, "2": 1, "4": 7, "5": 9, "6": 11, "7": 12}, **{"A": 10, "B": 10, "C": 9}},
}


def _rows(columns):
    lines = _PAGE.read_text(encoding="utf-8").splitlines()
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line[:1] == "|"]
    named = [row for row in cells if row[0] != "number" and set(row[0]) != {"-"}]
    return [row for row in named if len(row) == columns]


def _numbers(cell):
    """The numbers in a cell, such as `Eq. 5.2 to 5.4`, one by one."""
    found = []
    number = r"(?:([A-C\d])\.)?(\d+)"
    pattern = rf"(Eq\.|Alg\.|Tab\.|Fig\.) {number}(?: to (?:\1 )?{number})?"
    for kind, chapter, first, _, last in re.findall(pattern, cell):
        found += [(kind, chapter, n) for n in range(int(first), int(last or first) + 1)]
    return found


def test_every_number_of_the_thesis_is_on_the_page():
    there = {number for row in _rows(5) + _rows(4) for number in _numbers(row[0])}
    asked = {
        (kind, chapter, n)
        for kind, chapters in _NUMBERS.items()
        for chapter, count in chapters.items()
        for n in range(1, count + 1)
    }
    assert asked - there == set()
    assert there - asked == set()


@pytest.mark.parametrize("row", _rows(4), ids=lambda row: row[0])
def test_a_figure_or_table_names_its_script_or_says_why_not(row):
    _, what, script, picture = row
    assert what
    named = [_EXPERIMENTS / name for name in re.findall(r"`(?:experiments/)?(\w+\.py)", script)]
    assert named or script.startswith("none: "), script
    assert all(path.is_file() or (path.parent / "peers" / path.name).is_file() for path in named)
    for target in re.findall(r"\]\[([^\]]+)\]", script):
        _file_of(target)
    for page in re.findall(r"\]\((images/[^)]+)\)", picture):
        assert (_PAGE.parent / page).is_file(), page
    written = re.findall(r"`([^`]+)\.png`", picture)
    source = "".join(path.read_text(encoding="utf-8") for path in named if path.is_file())
    for name in written:
        # Names with a scene in them: what is around it stands in the script.
        assert all(part in source for part in re.split(r"\{\w+\}", name)), name


def _file_of(target):
    module, name = target.rsplit(".", 1)
    function = inspect.unwrap(getattr(importlib.import_module(module), name))
    return Path(inspect.getfile(function)).relative_to(_PACKAGE).as_posix()


@pytest.mark.parametrize("row", _rows(5), ids=lambda row: row[0])
def test_a_row_of_the_equations_names_what_is_there(row):
    _, _, functions, files, _ = row
    named = re.findall(r"`([^`]+\.py)`", files)
    sources = {file: (_PACKAGE / file).read_text(encoding="utf-8") for file in named}
    for target in re.findall(r"\]\[([^\]]+)\]", functions):
        assert _file_of(target) in sources, target
    for step in re.findall(r"`(\w+)`, run by", functions):
        assert any(f"def {step}(" in source for source in sources.values()), step


def _run(name, blocks, names: dict | None = None, smaller=lambda page: page):
    """The names that the Python blocks of a page define, run one after the other."""
    page = smaller((_PAGE.parent / name).read_text(encoding="utf-8"))
    names = {"__name__": "page"} if names is None else names
    for code in re.findall(r"```python\n(.*?)```", page, re.DOTALL)[blocks]:
        exec(compile(code.replace("print(", "("), name, "exec"), names)  # noqa: S102
    return names


def test_the_loss_of_ones_own_runs():
    names = _run("objectives.md", slice(None))
    history, found = names["history"], names["state"].best.disparity
    assert float(history.loss[-1]) < 0.5 * float(history.loss[0])
    np.testing.assert_allclose(found, 0.2, atol=0.05)


@pytest.mark.slow
def test_parts_of_ones_own_run():
    """A network for the smoothness learns, other filters find points, another solver converges."""
    with jax.numpy_dtype_promotion("standard"):  # Optax promotes
        names = _run("parts.md", slice(2, None))  # the first two blocks read a benchmark scene
    assert names["losses"][-1] < 0.9 * names["losses"][0]
    assert int(names["points"].valid.sum()) > 100
    assert bool(names["result"].stats.converged)


@pytest.mark.slow
def test_the_page_on_learning_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = _run("learning.md", slice(None))
    assert len(names["learned"].validation) == 3
    assert set(names["learned"].factors()) >= {"smoothness.color", "refine.precision"}
    assert (tmp_path / "learning.png").stat().st_size > 10_000
    assert names["light_field"].views.shape == (3, 3, 32, 32, 3)


def _small(page):
    """The page with fewer and smaller views, and fewer settings."""
    for old, new in (("9, 9, 128, 128", "5, 5, 32, 32"), ("trials=8", "trials=2, threads=1")):
        page = page.replace(old, new)
    return page


@pytest.mark.slow
def test_the_tutorial_runs_in_one_session():
    pages = sorted(path.name for path in _PAGE.parent.glob("tutorial-*.md"))
    assert [name[9] for name in pages] == ["1", "2", "3", "4", "5"]
    names: dict = {"__name__": "page"}
    with jax.numpy_dtype_promotion("standard"):  # the reader's part mixes precisions under x64
        for name in pages:
            _run(name, slice(None), names, _small)
    assert float(names["slope"].smoothness.color) != 0
    assert np.isfinite(names["tangent"]).all()
    assert any(row.path == "smoothness.scale" for row in names["mv"].describe(names["mine"]))
    assert set(names["best"].choices) == {"smoothness.color", "smoothness.depth"}
