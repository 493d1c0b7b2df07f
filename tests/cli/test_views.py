"""`mvedge views` and `mvedge edit`: everything is written, and right."""

import json

import cv2
import h5py
import numpy as np
import pytest
from cli.scenes import RANGE, textured_plane
from datasets.layouts import write_hci
from scipy import ndimage

from mvedge_jax.cli import _main
from mvedge_jax.datasets import load_light_field, read_pfm


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    truth = np.full((32, 40), 0.4, np.float32)
    return write_hci(tmp_path_factory.mktemp("views") / "plane", textured_plane(), disparity=truth)


def test_views_writes_maps_of_all_views(scene, tmp_path):
    out = tmp_path / "out"
    assert _main.main(["views", str(scene), str(out)]) == 0
    with h5py.File(out / "views.h5") as file:
        every = np.asarray(file["disparity"])
        assert np.asarray(file["source"]).max() <= 2
        assert np.isfinite(np.asarray(file["error"])).all()
    for k in range(9):
        found = read_pfm(out / f"disparity_Cam{k:03d}.pfm")
        np.testing.assert_array_equal(found, every[k // 3, k % 3])
        assert np.median(np.abs(found - 0.4)) < 0.01
    report = json.loads((out / "report.json").read_text())
    assert sum(report["share of pixels known from"].values()) == pytest.approx(1)
    assert report["scores"]["consistency*100"] < 0.01
    assert report["warnings"] == []
    for name in ("views.png", "views.gif", "consistency.png"):
        assert (out / name).stat().st_size > 0


@pytest.mark.slow
def test_a_single_row_of_views(tmp_path):
    rng = np.random.default_rng(1)
    texture = ndimage.gaussian_filter(rng.uniform(size=(52, 60, 3)), (0.9, 0.9, 0)) * 2 - 0.5
    y, x = np.mgrid[0:32, 0:40].astype(float) + 10
    views = np.stack(
        [
            [
                ndimage.map_coordinates(texture[..., c], [y, x - (4 - u) * 0.4], order=3)
                for c in range(3)
            ]
            for u in range(9)
        ]
    )
    pixels = np.round(255 * np.clip(views.transpose(0, 2, 3, 1), 0, 1)).astype(np.uint8)
    scene = write_hci(tmp_path / "row", pixels[None])
    assert _main.main(["depth", str(scene), str(tmp_path / "depth")]) == 0
    found = read_pfm(tmp_path / "depth" / "disparity.pfm")
    assert np.median(np.abs(found - 0.4)) < 0.01
    assert _main.main(["views", str(scene), str(tmp_path / "views")]) == 0
    for k in range(9):
        found = read_pfm(tmp_path / "views" / f"disparity_Cam{k:03d}.pfm")
        assert np.median(np.abs(found - 0.4)) < 0.01


def test_edit_puts_a_picture_before_the_plane(scene, tmp_path):
    picture, out = tmp_path / "red.png", tmp_path / "out"
    cv2.imwrite(str(picture), np.full((5, 5, 3), (0, 0, 255), np.uint8))
    words = ["edit", str(scene), str(out), "--insert", str(picture), "--disparity", "2"]
    assert _main.main([*words, "--at", "20", "16"]) == 0
    edited = load_light_field(out)
    for v, u in np.ndindex(3, 3):
        place = 16 + 2 * (1 - v), 20 + 2 * (1 - u)
        np.testing.assert_allclose(edited.views[v, u][place], [1, 0, 0], atol=0.01)


def test_a_picture_behind_everything_is_told(scene, tmp_path, capsys):
    picture, out = tmp_path / "red.png", tmp_path / "out"
    cv2.imwrite(str(picture), np.full((5, 5, 3), (0, 0, 255), np.uint8))
    words = ["edit", str(scene), str(out), "--insert", str(picture), "--disparity", "-3"]
    assert _main.main(words) == 0
    warnings = json.loads((out / "report.json").read_text())["warnings"]
    assert any("nothing was changed" in sentence for sentence in warnings)
    assert "nothing was changed" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["views", "edit", "superpixels", "batch"])
def test_what_speaks_against_the_depth_is_said(command, tmp_path, capsys):
    """Black views tell nothing: on the screen, and in report.json."""
    scene = write_hci(tmp_path / "black", np.zeros((3, 3, 32, 40, 3), np.uint8))
    mask, out = tmp_path / "mask.png", tmp_path / "out"
    cv2.imwrite(str(mask), np.full((32, 40), 255, np.uint8))
    more = {"edit": ["--mask", str(mask), "--colour", "1", "0", "0"], "batch": [*RANGE]}
    assert _main.main([command, str(scene), str(out), *more.get(command, [])]) == 0
    said = capsys.readouterr().err
    folder = out / "black" if command == "batch" else out
    warnings = json.loads((folder / "report.json").read_text())["warnings"]
    assert len(warnings) >= 2
    for sentence in warnings:
        assert sentence in said
    assert any("no edge was found" in sentence for sentence in warnings)
    assert any(
        "half of the pixels have a standard error above" in sentence for sentence in warnings
    )
