import csv
import json

import numpy as np
import pytest
from datasets.layouts import write_hci

from mvedge_jax.cli import _main
from mvedge_jax.cli._sweep import _choice, _interval
from mvedge_jax.sweep import Interval


@pytest.fixture
def scenes(tmp_path):
    views = np.full((3, 3, 8, 8, 3), 128, np.uint8)
    truth = np.zeros((8, 8), np.float32)
    return [write_hci(tmp_path / name, views, disparity=truth) for name in ("a", "b")]


@pytest.fixture
def scored(monkeypatch):
    def score(scene, rows, *, names, choices, preset, objective, batch):
        return (np.log(rows[:, 0] / 0.008)) ** 2 + (choices["measurement.views"] == "all")

    monkeypatch.setattr("mvedge_jax.sweep._sweep.evaluate", score)


def test_a_sweep_writes_the_best_setting(scenes, scored, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["sweep", *map(str, scenes), str(out), "--vary", "refine.precision=0.002:0.02"]
    words += ["--choose", "measurement.views=crosshair,all", "--trials", "40"]
    assert _main.main(words) == 0
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
    assert "refine.precision = " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--vary", "refine.precision"], "expected PATH=LOW:HIGH"),
        (["--vary", "refine.precision=1:x"], "expected PATH=LOW:HIGH"),
        (["--vary", "refine.precision=1:nan"], "must be finite"),
        (["--vary", "refine.precison=1:2"], "`refine.precison` is no path of `EdgeDepth`"),
        (["--vary", "dense.trust=1:2", "--preset", "edges"], "`dense.trust` is no path"),
        (
            ["--vary", "dense.trust=1:2", "--set", "refine.solves=0"],
            "--set refine.solves: `solves`",
        ),
        (["--choose", "views"], "expected PATH=A,B"),
        (["--vary", "dense.trust=1:2", "--workers", "-1"], "--workers must not be negative"),
        ([], "at least one number or choice"),
    ],
)
def test_mistakes_are_told(words, message, scenes, tmp_path, capsys):
    assert _main.main(["sweep", str(scenes[0]), str(tmp_path / "out"), *words]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_intervals_and_choices_are_read():
    assert _interval("dense.trust=0.7:2.8") == ("dense.trust", Interval(0.7, 2.8))
    assert _interval("x=-1:2:linear") == ("x", Interval(-1.0, 2.0, log=False))
    assert _choice("refine.solves=1,2") == ("refine.solves", (1, 2))
    assert _choice("solver.by_residual=true,false") == ("solver.by_residual", (True, False))
    assert _choice("refine.slopes=none") == ("refine.slopes", (None,))
    assert _choice("views=crosshair,all") == ("views", ("crosshair", "all"))
