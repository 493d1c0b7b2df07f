import json

import cv2
import numpy as np
import pytest
from cli.scenes import RANGE, textured_plane
from datasets.layouts import write_hci

from mvedge_jax.cli import _common, _depth, _tiles
from mvedge_jax.datasets import read_pfm
from mvedge_jax.tiles import Window


def test_depth_writes_everything_and_is_right(scene, tmp_path, mvedge, monkeypatch):
    out, viewed = tmp_path / "out", []
    monkeypatch.setattr(_depth, "show", lambda *given: viewed.append(given))
    assert "written to" in mvedge("depth", scene, out, *RANGE, "--view").out
    found = read_pfm(out / "disparity.pfm")
    ((field, (shown,)),) = viewed
    assert field.views.shape == (3, 3, 32, 40, 3)
    np.testing.assert_array_equal(shown.disparity, found)
    assert len(shown.xy) == len(shown.points) > 50
    assert found.shape == (32, 40)
    assert np.median(np.abs(found - 0.4)) < 0.01
    report = json.loads((out / "report.json").read_text())
    low, high = report["disparity range"]
    sixteen = cv2.imread(str(out / "disparity16.png"), cv2.IMREAD_UNCHANGED)
    assert sixteen is not None
    assert sixteen.dtype == np.uint16
    np.testing.assert_allclose(low + sixteen / 65535 * (high - low), found, atol=1e-4)
    points = np.load(out / "points.npz")
    assert len(points["xy"]) == report["counts"]["valid"] > 50
    table = np.genfromtxt(out / "points.csv", delimiter=",", names=True)
    np.testing.assert_allclose(table["x"], points["xy"][:, 0], atol=1e-3)
    np.testing.assert_allclose(table["surface_y"], points["surface_vector"][:, 1], atol=1e-3)
    assert set(report["scores"]) == {"crop 0", "crop 15"}
    assert report["scores"]["crop 0"]["mse"] < 0.1
    photometry = report["photometry"]
    assert photometry["noise of 255"] > 0.28
    assert 0 <= photometry["share that noise rules"] < 1
    assert photometry["brightened by"] >= 1
    assert np.allclose(photometry["gain of the center row of views"], 1, atol=0.02)
    assert report["preset"] == "full"
    # Four times that of 9x9 views.
    assert report["numbers"]["refine.precision"] == 0.02
    assert report["numbers"]["smoothness.color"] == 0.3
    assert report["static fields"]["refine.solves"] == 2
    assert report["static fields"]["measurement.views"] == "crosshair"
    error = read_pfm(out / "standard_error.pfm")
    assert error.shape == found.shape
    assert 0 < report["standard error, median and 95 %"][0] == pytest.approx(np.median(error))
    assert report["scores"]["crop 0"]["within_two_errors"] > 0.8
    for name in ("disparity.png", "standard_error.png", "error_log.png", "error_signed.png"):
        assert cv2.imread(str(out / name)) is not None, name


@pytest.mark.slow
def test_a_preset_and_settings_are_estimated_with_and_reported(scene, tmp_path, mvedge):
    words = ["--preset", "edges", "--set", "smoothness.color=.4", "--set", "refine.solves=1"]
    words += ["--range", "-0.5", "1", "--seed", "3"]
    mvedge("depth", scene, tmp_path / "out", *words)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert (report["preset"], report["seed"]) == ("edges", 3)
    assert report["numbers"]["smoothness.color"] == 0.4
    assert report["static fields"]["refine.solves"] == 1
    # Two directional diffusions and one solve.
    assert len(report["diffusion iterations"]) == 3
    found = read_pfm(tmp_path / "out" / "disparity.pfm")
    assert np.median(np.abs(found - 0.4)) < 0.01


def test_nothing_is_left_behind_when_interrupted(scene, tmp_path, mvedge, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(_common, "compiled", lambda *_, **__: interrupt)
    mvedge("depth", scene, tmp_path / "out", "--range", 0, 1, code=130)
    assert list(tmp_path.iterdir()) == []


def test_a_black_view_is_named_and_costs_little(tmp_path, mvedge):
    """Its gain was 0, and all of the map NaN."""
    views = textured_plane()
    views[1, 2] = 0
    folder = write_hci(tmp_path / "plane", views, disparity=np.full((32, 40), 0.4, np.float32))
    said = mvedge("depth", folder, tmp_path / "out", *RANGE).err
    found = read_pfm(tmp_path / "out" / "disparity.pfm")
    assert np.median(np.abs(found - 0.4)) < 0.01
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["warnings"] == [
        "plane: 1 of 9 views left out as missing, as they do not show the scene: input_Cam005.png "
        "is black."
    ]
    assert report["warnings"][0] in said


def test_tiles(scene, tmp_path, mvedge, monkeypatch):
    """Of one tile, which is the image: its program is there."""

    def whole(stored, *, model, tiling, key, progress):
        assert (tiling.side, key is None) == (200, False)
        progress(1, 1)
        return model(stored.window(Window(0, 0, *stored.shape[2:])))

    monkeypatch.setattr(_tiles, "depth_in_tiles", whole)
    out = tmp_path / "out"
    mvedge("depth", scene, out, *RANGE, "--tile", 200)
    assert np.median(np.abs(read_pfm(out / "disparity.pfm") - 0.4)) < 0.01
    report = json.loads((out / "report.json").read_text())
    assert report["shape [v, u, y, x]"] == [3, 3, 32, 40]
    assert report["scores"]["crop 0"]["mse"] < 0.1
    assert len(np.load(out / "points.npz")["xy"]) == report["counts"]["valid"] > 50
