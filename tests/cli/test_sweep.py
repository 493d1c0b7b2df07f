import csv
import json

import numpy as np
import pytest
from cli.scenes import gray_scenes

from mvedge_jax.cli._sweep import _choice, _interval
from mvedge_jax.sweep import Interval


def test_a_sweep_writes_the_best_setting(tmp_path, mvedge, monkeypatch):
    def score(scene, rows, *, names, choices, preset, objective, batch):
        return (np.log(rows[:, 0] / 0.008)) ** 2 + (choices["measurement.views"] == "all")

    monkeypatch.setattr("mvedge_jax.sweep._sweep.evaluate", score)
    out = tmp_path / "out"
    words = ["sweep", *gray_scenes(tmp_path, "ab"), out, "--vary", "refine.precision=0.002:0.02"]
    words += ["--choose", "measurement.views=crosshair,all", "--trials", 40]
    assert "refine.precision = " in mvedge(*words).out
    best = json.loads((out / "best.json").read_text())
    assert best["setting"]["refine.precision"] == pytest.approx(0.008, rel=0.2)
    assert best["setting"]["measurement.views"] == "crosshair"
    with (out / "trials.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 40
    assert min(float(row["mean"]) for row in rows) == pytest.approx(best["bad_07"])
    assert float(rows[0]["refine.precision"]) == pytest.approx(0.005)
    assert (out / "sweep.png").stat().st_size > 10_000
    assert (tmp_path / "out.journal").exists()


def test_intervals_and_choices_are_read():
    assert _interval("dense.trust=0.7:2.8") == ("dense.trust", Interval(0.7, 2.8))
    assert _interval("x=-1:2:linear") == ("x", Interval(-1.0, 2.0, log=False))
    assert _choice("refine.solves=1,2") == ("refine.solves", (1, 2))
    assert _choice("solver.by_residual=true,false") == ("solver.by_residual", (True, False))
    assert _choice("refine.slopes=none") == ("refine.slopes", (None,))
    assert _choice("views=crosshair,all") == ("views", ("crosshair", "all"))
