import csv
import json

import numpy as np
import pytest
from datasets.layouts import random_views, write_hci
from helpers import shared_data

from mvedge_jax.cli._eval import evaluate
from mvedge_jax.datasets import write_pfm


def _rows(text):
    """Table rows by crop: {crop: {column: text}}."""
    lines = [line for line in text.splitlines() if line.strip()]
    start = next(i for i, line in enumerate(lines) if line.lstrip().startswith("crop "))
    names = ["crop", "mse", "mae", "q25", "bad_01", "bad_03", "bad_07", "emse", "ebad", "pixels"]
    rows = [dict(zip(names, line.split(), strict=True)) for line in lines[start + 1 : start + 3]]
    return {int(row["crop"]): row for row in rows}


@pytest.fixture
def scene(tmp_path):
    """A scene with a step in depth, 40x48 px."""
    truth = np.where(np.arange(48) < 24, -0.5, 0.75).astype(np.float32) * np.ones((40, 1), "f4")
    views = random_views((3, 3, 40, 48, 3))
    return write_hci(tmp_path / "toy", views, disparity=truth), truth


def test_scores_with_and_without_the_border(scene, tmp_path, capsys):
    folder, truth = scene
    wrong = truth.copy()
    wrong[10:30, 10:38] += 0.05
    wrong[:, :10] += 1.0
    write_pfm(tmp_path / "d.pfm", wrong)
    evaluate(tmp_path / "d.pfm", folder, crop=10)
    rows = _rows(capsys.readouterr().out)
    inner = 20 * 28
    assert int(rows[0]["pixels"]) == 40 * 48
    assert int(rows[10]["pixels"]) == inner
    assert float(rows[10]["mse"]) == pytest.approx(0.25, rel=1e-3)
    assert float(rows[10]["bad_03"]) == 100
    assert float(rows[10]["bad_07"]) == 0
    assert float(rows[0]["mse"]) == pytest.approx(
        100 * (400 + 0.0025 * inner) / (40 * 48), rel=1e-3
    )
    assert float(rows[0]["bad_07"]) == pytest.approx(100 * 400 / (40 * 48), rel=1e-3)


def test_a_smaller_map_is_the_center(scene, tmp_path, capsys):
    folder, truth = scene
    wrong = truth + 0.02
    write_pfm(tmp_path / "whole.pfm", wrong)
    write_pfm(tmp_path / "part.pfm", wrong[3:-3, 4:-4])
    evaluate(tmp_path / "whole.pfm", folder, crop=8)
    whole = _rows(capsys.readouterr().out)
    evaluate(tmp_path / "part.pfm", folder, crop=8)
    text = capsys.readouterr().out
    part = _rows(text)
    assert "without 4 columns at the left and 3 rows at the top" in text
    assert part[8] == whole[8]  # the crop counts from the border of the ground truth
    assert int(part[0]["pixels"]) == 34 * 40


def test_files_are_written(scene, tmp_path, capsys):
    folder, truth = scene
    wrong = truth + 0.02
    wrong[0, 0] = np.nan
    write_pfm(tmp_path / "d.pfm", wrong)
    out = tmp_path / "deep" / "scores"
    evaluate(tmp_path / "d.pfm", folder, crop=2, out=out)
    assert "1 disparities" in capsys.readouterr().err
    names = {path.name for path in out.iterdir()}
    assert {"scores.json", "scores.csv", "comparison.png", "error_signed.png"} <= names
    whole, inner = json.loads((out / "scores.json").read_text())["scores"]
    assert (whole["crop"], inner["crop"]) == (0, 2)
    assert whole["mse"] is None  # infinite: JSON has no such number
    assert whole["not_finite"] == 1
    assert inner["mse"] == pytest.approx(0.04, rel=1e-3)
    with (out / "scores.csv").open(newline="") as stream:
        assert [float(row["bad_01"]) for row in csv.DictReader(stream)] == [100.0, 100.0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "figures"),
    [
        ("spo", {"mse": 1.313, "bad_01": 69.06, "bad_03": 13.71, "bad_07": 2.594}),
        ("fastlfnet", {"mse": 0.322, "bad_01": 49.34, "bad_03": 6.785, "bad_07": 0.714}),
        ("epinet", {"mse": 0.27, "q25": 0.32, "bad_01": 31.0, "bad_03": 2.8, "bad_07": 0.51}),
    ],
)
def test_published_figures(method, figures, tmp_path, capsys):
    """The benchmark's own figures of cotton, to every digit that they are printed with."""
    result = shared_data("peer_results", method, "cotton.pfm")
    evaluate(result, shared_data("hci", "cotton"), out=tmp_path / "out")
    record = json.loads((tmp_path / "out" / "scores.json").read_text())["scores"][1]
    assert record["crop"] == 15
    for name, published in figures.items():
        digits = len(str(published).partition(".")[2])
        assert round(record[name], digits) == published, name
    text = capsys.readouterr().out
    assert ("490x490 px: it is taken to be the center" in text) == (method == "epinet")
