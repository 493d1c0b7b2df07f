"""`mvedge views` and `mvedge edit`: everything is written, and right."""

import json

import cv2
import h5py
import numpy as np
import pytest
from cli.scenes import RANGE, textured_plane
from datasets.layouts import write_hci

from mvedge_jax.datasets import load_light_field, read_pfm


def test_views_writes_maps_of_all_views(scene, tmp_path, mvedge):
    out = tmp_path / "out"
    mvedge("views", scene, out)
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
def test_a_single_row_of_views(tmp_path, mvedge):
    scene = write_hci(tmp_path / "row", textured_plane(grid=(1, 9)))
    mvedge("depth", scene, tmp_path / "depth")
    found = read_pfm(tmp_path / "depth" / "disparity.pfm")
    assert np.median(np.abs(found - 0.4)) < 0.01
    mvedge("views", scene, tmp_path / "views")
    for k in range(9):
        found = read_pfm(tmp_path / "views" / f"disparity_Cam{k:03d}.pfm")
        assert np.median(np.abs(found - 0.4)) < 0.01


@pytest.fixture
def edit(scene, tmp_path, mvedge):
    """Puts a red picture into the scene; the folder of the result, and what is said."""

    def run(*words):
        picture, out = tmp_path / "red.png", tmp_path / "out"
        cv2.imwrite(str(picture), np.full((5, 5, 3), (0, 0, 255), np.uint8))
        return out, mvedge("edit", scene, out, "--insert", picture, *words).err

    return run


def test_edit_puts_a_picture_before_the_plane(edit):
    edited = load_light_field(edit("--disparity", 2, "--at", 20, 16)[0])
    for v, u in np.ndindex(3, 3):
        place = 16 + 2 * (1 - v), 20 + 2 * (1 - u)
        np.testing.assert_allclose(edited.views[v, u][place], [1, 0, 0], atol=0.01)


def test_a_picture_behind_everything_is_told(edit):
    out, said = edit("--disparity", -3)
    warnings = json.loads((out / "report.json").read_text())["warnings"]
    assert any("nothing was changed" in sentence for sentence in warnings)
    assert "nothing was changed" in said


@pytest.mark.parametrize("command", ["views", "edit", "superpixels", "batch"])
def test_what_speaks_against_the_depth_is_said(command, tmp_path, mvedge):
    """Black views tell nothing: on the screen, and in report.json."""
    scene = write_hci(tmp_path / "black", np.zeros((3, 3, 32, 40, 3), np.uint8))
    mask, out = tmp_path / "mask.png", tmp_path / "out"
    cv2.imwrite(str(mask), np.full((32, 40), 255, np.uint8))
    more = {"edit": ("--mask", mask, "--color", 1, 0, 0), "batch": RANGE}
    more["superpixels"] = ("--count", 20)  # has a program
    said = mvedge(command, scene, out, *more.get(command, [])).err
    folder = out / "black" if command == "batch" else out
    warnings = json.loads((folder / "report.json").read_text())["warnings"]
    assert len(warnings) >= 2
    for sentence in warnings:
        assert sentence in said
    assert any("no edge was found" in sentence for sentence in warnings)
    assert any("half of the pixels have a standard error" in sentence for sentence in warnings)
