import csv
import json
import re

import cv2
import numpy as np
import pytest
from cli.scenes import write_plane

from mvedge_jax.datasets import read_pfm


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_plane(tmp_path_factory.mktemp("optimize") / "plane", 24, 28)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    ["--supervised", "--supervised --no-recycle --grow-points 6", "--loss reprojection", ""],
)
def test_optimize_writes_everything_and_ends_no_worse(scene, tmp_path, mvedge, options):
    out = tmp_path / "out"
    words = ("--iterations", 8, "--raster", 1, *options.split())
    printed = mvedge("optimize", scene, out, *words).out
    # Only a known map says where points are missing.
    assert ("points moved to where the map was wrong" in printed) == ("--supervised" in options)
    if "--no-recycle" in options:
        assert re.findall(r"(\d+) points moved", printed) == ["0"] * 5
    elif "--supervised" in options:
        assert re.findall(r"wrong, (\d+) added", printed) == ["0"] * 5
    report = json.loads((out / "report.json").read_text())
    scores = report["scores"]
    assert scores["after"]["mse"] <= scores["before"]["mse"] * 1.2 + 1e-3
    assert report["iterations"] == 8
    found = read_pfm(out / "disparity.pfm")
    assert np.median(np.abs(found - 0.4)) < 0.01
    with (out / "loss.csv").open() as file:
        losses = [float(row["loss"]) for row in csv.DictReader(file)]
    assert len(losses) == 8
    with np.load(out / "points.npz") as points:
        assert len(points["xy"]) == report["points"]
    for name in ("before.png", "after.png", "after_error.png", "loss.png"):
        assert cv2.imread(str(out / name)) is not None, name
    assert (out / "state.eqx").is_file()


@pytest.mark.slow
def test_chapter_7_as_printed_starts_from_the_points_alone(scene, tmp_path, mvedge):
    out = tmp_path / "out"
    words = ("--loss", "printed", "--preset", "edges", "--iterations", 1)
    mvedge("optimize", scene, out, *words)
    report = json.loads((out / "report.json").read_text())
    assert report["iterations"] == 20  # four parameters, five passes
    assert report["kept the optimized points"]
    with np.load(out / "points.npz") as points:
        assert len(points["xy"]) > 20
    before, after = read_pfm(out / "before.pfm"), read_pfm(out / "disparity.pfm")
    assert np.median(np.abs(before - 0.4)) < 0.02
    assert np.median(np.abs(after - 0.4)) < 0.02
    assert np.abs(after - before).max() > 1e-4
    failed = mvedge("optimize", scene, tmp_path / "no", *words, "--supervised", code=2)
    assert "--loss printed reads views alone" in failed.err
