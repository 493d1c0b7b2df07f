"""`mvedge demo`: leaves what it promises, or nothing."""

import csv
import json

import cv2
import numpy as np
import pytest

from mvedge_jax.cli import _demo, main
from mvedge_jax.datasets import read_pfm

_FIGURES = {"views", "epi", "disparity", "comparison", "error_signed", "boundaries"}


@pytest.fixture
def only_the_baseline(monkeypatch):
    """The method takes a minute to compile; the slow test runs it."""
    monkeypatch.setattr(_demo, "_METHODS", {"plane sweep": _demo._METHODS["plane sweep"]})


@pytest.mark.usefixtures("only_the_baseline")
def test_figures_and_metrics_are_on_disk(tmp_path, capsys):
    out = tmp_path / "a" / "demo"
    assert main(["demo", str(out), "--views", "3", "--size", "40", "48"]) == 0
    assert {path.stem for path in out.glob("*.png")} == _FIGURES
    for path in out.glob("*.png"):
        assert np.std(np.asarray(cv2.imread(str(path)))) > 5, f"{path.name} is blank"
    disparity = read_pfm(out / "disparity_plane_sweep.pfm")
    assert disparity.shape == (40, 48)
    assert np.isfinite(disparity).all()
    (row,) = csv.DictReader((out / "metrics.csv").read_text().splitlines())
    summary = json.loads((out / "metrics.json").read_text())
    (method,) = summary["methods"]
    assert row["method"] == method["name"] == "plane sweep"
    assert float(row["MSE*100"]) == method["MSE*100"]
    assert 0 < method["MSE*100"] < 30  # the truth's variance x 100 is 80
    assert method["BP(0.01) %"] > method["BP(0.07) %"] > 0
    assert summary["shape [v, u, y, x]"] == [3, 3, 40, 48]
    printed = capsys.readouterr().out
    assert "MSE*100" in printed
    assert str(out) in printed


@pytest.mark.slow
def test_the_method_beats_the_baseline(tmp_path):
    out = tmp_path / "demo"
    assert main(["demo", str(out)]) == 0
    assert {path.stem for path in out.glob("*.png")} == _FIGURES | {"edges"}
    sweep, method = json.loads((out / "metrics.json").read_text())["methods"]
    for name in ("MSE*100", "BP(0.07) %", "edge MSE*100"):
        assert method[name] < sweep[name], name
    assert method["boundary F1"] > sweep["boundary F1"]
