"""Figures of the pages are those of the results; results know the code that they depend on."""

import json
import shutil
import warnings

import pytest

from experiments import _report, pages
from experiments._published import published
from experiments._tables import TABLES, Results


@pytest.fixture
def copy(tmp_path):
    """A checkout with all that pages are made of."""
    for name in ("docs", "experiments", "mvedge_jax"):
        skip = shutil.ignore_patterns("images", "*.png", "*.js", "__pycache__")
        shutil.copytree(_report.ROOT / name, tmp_path / name, ignore=skip)
    shutil.copy(_report.ROOT / "README.md", tmp_path)
    return tmp_path


# Stale results are listed, not an error: renewing them takes hours.
@pytest.mark.filterwarnings("default:stale")
def test_every_figure_of_the_pages_is_that_of_the_results():
    assert pages.disagreements() == []
    for line in pages.stale():
        warnings.warn(f"stale: {line}", stacklevel=1)


def test_a_wrong_figure_on_a_page_is_found_and_mended(copy, capsys):
    page = copy / "docs" / "accuracy.md"
    right = page.read_text(encoding="utf-8")
    table = right.index("<!-- results: edges -->")
    start = right.index(" % |", table) - 1
    other = "0" if right[start] != "0" else "1"
    page.write_text(right[:start] + other + right[start + 1 :], encoding="utf-8")
    assert pages.disagreements(copy) == ["docs/accuracy.md: edges"]
    assert pages.main(["--check"], copy) == 1
    assert "differs from the results: docs/accuracy.md: edges" in capsys.readouterr().out
    assert pages.main([], copy) == 0
    assert page.read_text(encoding="utf-8") == right


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<!-- results: edges -->\n", "page.md: each `<!-- results: ...` needs"),
        (
            "<!-- results: edge --><!-- /results -->",
            "page.md: 'edge' is none of the tables accuracy",
        ),
        (
            "<!-- results: program cotton --><!-- /results -->",
            "`<!-- results: program cotton` is within a sentence",
        ),
        (
            "<!-- results: step no_such_step --><!-- /results -->",
            "thesis_steps.json has 0 rows with .*no_such_step",
        ),
    ],
)
def test_a_marker_that_leads_nowhere_is_an_error(tmp_path, text, message):
    page, results = tmp_path / "page.md", Results(_report.ROOT / "experiments" / "results")
    page.write_text(text)
    with pytest.raises(ValueError, match=message):
        pages.updated(page, results)
    with pytest.raises(ValueError, match="has no table_0.json; it has .*calibration, codec"):
        results.rows("table_0")


def test_every_table_is_on_a_page_and_every_result_is_small():
    text = "".join(page.read_text(encoding="utf-8") for page in pages.pages(_report.ROOT))
    assert {name for name in TABLES if f"<!-- results: {name} " not in text} == set()
    folder = _report.ROOT / "experiments" / "results"
    assert {path.name for path in folder.glob("*.json") if path.stat().st_size > 2**16} == set()


def test_a_result_is_stale_when_code_changes_but_not_when_a_comment_does(copy, capsys):
    folder = copy / "experiments" / "results"
    shutil.rmtree(folder)
    folder.mkdir()
    origin = {"commit": "", "date": "", "command": ""}
    depends = _report.digests(["mvedge_jax/epi/*.py", "mvedge_jax/metrics/*.py"], copy)
    found = {**origin, "depends": depends, "content": []}
    (folder / "found.json").write_text(json.dumps(found))
    for page in pages.pages(copy):
        page.unlink()
    (copy / "README.md").write_text("no figures")
    module = copy / "mvedge_jax" / "metrics" / "depth.py"
    text = module.read_text(encoding="utf-8")
    module.write_text("# Another comment.\n\n" + text, encoding="utf-8")
    assert pages.stale(copy) == []
    module.write_text(text + "\n_ANOTHER = 1\n", encoding="utf-8")
    assert pages.stale(copy) == ["found.json: mvedge_jax/metrics/*.py"]
    assert pages.main(["--check"], copy) == 0
    assert "stale: found.json: mvedge_jax/metrics/*.py" in capsys.readouterr().out
    assert pages.main(["--check", "--strict"], copy) == 1


def test_figures_depend_on_what_was_learned(copy):
    import mvedge_jax.depth  # noqa: F401  its arrays are among what this process runs

    pattern = "mvedge_jax/depth/*.npz"
    assert pattern in _report.imported_code()
    before = _report.digests([pattern], copy)
    learned = copy / "mvedge_jax" / "depth" / "learned.npz"
    learned.write_bytes(learned.read_bytes() + b"1")
    assert _report.digests([pattern], copy) != before


def test_published_tables_are_those_that_the_thesis_prints():
    (ours,) = published("6.1", scene="average", method="Ours")
    assert (ours["MSE*100"], ours["Q25*100"], ours["seconds"]) == (2.43, 1.05, 35.4)
    scenes = ("sideboard", "dino", "cotton", "boxes")
    for method in ("Jeon", "Zhang", "Jiang", "Shi", "Li", "Wang", "Ours"):
        rows = [published("6.1", scene=scene, method=method)[0] for scene in scenes]
        (mean,) = published("6.1", scene="average", method=method)
        assert mean["MSE*100"] == pytest.approx(sum(row["MSE*100"] for row in rows) / 4, abs=0.03)
        assert mean["seconds"] == pytest.approx(sum(row["seconds"] for row in rows) / 4, abs=0.9)
    (cotton,) = published("7.2", scene="cotton", method="Ours")
    assert [cotton[name] for name in ("MSE*100", "BP(.01)", "BP(.07)")] == [3.07, 31.1, 4.06]
    with pytest.raises(ValueError, match="`table` must be one of 6.1, 6.2, .*got '5.1'"):
        published("5.1")
