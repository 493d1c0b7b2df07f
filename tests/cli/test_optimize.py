import csv
import json
import re

import cv2
import numpy as np
import pytest
from datasets.layouts import write_hci
from scipy import ndimage

from mvedge_jax.cli import _main
from mvedge_jax.datasets import read_pfm


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A textured plane at disparity 0.4, 3x3 views of 24x28 px, in the HCI layout."""
    rng = np.random.default_rng(0)
    texture = ndimage.gaussian_filter(rng.uniform(size=(44, 48, 3)), (0.9, 0.9, 0)) * 2 - 0.5
    y, x = np.mgrid[0:24, 0:28].astype(float) + 10
    views = np.zeros((3, 3, 24, 28, 3))
    for v, u in np.ndindex(3, 3):
        for c in range(3):
            place = [y - (1 - v) * 0.4, x - (1 - u) * 0.4]
            views[v, u, ..., c] = ndimage.map_coordinates(texture[..., c], place, order=3)
    views = np.round(255 * np.clip(views, 0, 1)).astype(np.uint8)
    truth = np.full((24, 28), 0.4, np.float32)
    return write_hci(tmp_path_factory.mktemp("optimize") / "plane", views, disparity=truth)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        ["--supervised"],
        ["--supervised", "--no-recycle", "--grow-points", "6"],
        ["--loss", "reprojection"],
        [],
    ],
)
def test_optimize_writes_everything_and_ends_no_worse(scene, tmp_path, capsys, options):
    out = tmp_path / "out"
    words = ["optimize", str(scene), str(out), "--iterations", "8", "--raster", "1", *options]
    status = _main.main(words)
    printed, complaint = capsys.readouterr()
    assert status == 0, complaint
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


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--features", "vgg16"], "needs --vgg16 FILE"),
        (["--features", "vgg16", "--vgg16", "none.npz"], "no file of VGG16 weights"),
        (["--iterations", "0"], "--iterations must be at least 1, got 0"),
        (["--grow-points", "5"], "--grow-points needs --supervised"),
        (["--grow-points", "-1"], "--grow-points must not be negative, got -1"),
    ],
)
def test_mistakes_are_one_line(scene, tmp_path, capsys, options, message):
    assert _main.main(["optimize", str(scene), str(tmp_path / "out"), *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error
    assert not (tmp_path / "out").exists()
