"""A rendered light field, written in the HCI layout and read back."""

from typing import Any

import cv2
import equinox as eqx
import jax
import numpy as np
import pytest

from mvedge_jax.datasets import load_light_field, synthetic, write_hci
from mvedge_jax.lightfield import LightField

SHAPE = (5, 5, 60, 54)


@pytest.fixture(scope="module")
def light_field() -> Any:
    return synthetic.render(synthetic.scene("edges"), shape=SHAPE, samples=1, key=jax.random.key(0))


def test_everything_comes_back(light_field, tmp_path):
    write_hci(light_field, tmp_path / "deep" / "scene")
    back: Any = load_light_field(tmp_path / "deep" / "scene")
    assert back.views.shape == (*SHAPE, 3)
    np.testing.assert_allclose(back.views, light_field.views, atol=0.5 / 255 + 1e-6)
    for name in ("disparity", "valid", "object_ids", "view_disparity", "view_ids"):
        np.testing.assert_array_equal(getattr(back.truth, name), getattr(light_field.truth, name))
    for name in ("focal_px", "baseline", "focus_distance"):
        np.testing.assert_allclose(
            getattr(back.camera, name), getattr(light_field.camera, name), rtol=1e-6
        )
    np.testing.assert_allclose(back.disparity_range, light_field.disparity_range, rtol=1e-6)


def test_files_are_the_benchmarks(light_field, tmp_path):
    visible = np.zeros(SHAPE, bool)
    visible[3, 2] = True
    done = []
    write_hci(
        light_field,
        tmp_path,
        visible=visible,
        progress=lambda k, n: done.append((k, n)),
    )
    # View 013 of a 5x5 grid is row 2, column 3; OpenCV has blue first.
    image = cv2.imread(str(tmp_path / "input_Cam013.png"))
    assert image is not None
    np.testing.assert_allclose(image[..., ::-1] / 255, light_field.views[2, 3], atol=0.0021)
    ids = cv2.imread(str(tmp_path / "objectids_lowres.png"), cv2.IMREAD_UNCHANGED)
    assert ids is not None
    assert ids.dtype == np.uint16
    for number, value in ((17, 255), (0, 0)):
        mask = cv2.imread(str(tmp_path / f"visible_Cam{number:03d}.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(mask, np.full(SHAPE[2:], value, np.uint8))
    assert done[0] == (1, 25)
    assert done[-1] == (25, 25)
    assert len(list(tmp_path.glob("input_Cam*.png"))) == 25


def test_missing_views_and_unknowns_are_left_out(light_field, tmp_path):
    available = np.zeros(SHAPE[:2], bool)
    available[2], available[:, 2] = True, True
    views = np.where(available[..., None, None, None], np.asarray(light_field.views), 0)
    write_hci(LightField(views, available=available), tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {f"input_Cam{k:03d}.png" for k in (2, 7, 10, 11, 12, 13, 14, 17, 22)} | {
        "parameters.cfg"
    }
    back = load_light_field(tmp_path)
    np.testing.assert_array_equal(back.available, available)
    assert back.truth is None
    assert back.camera is None


def test_mistakes_are_explained(light_field, tmp_path):
    with pytest.raises(ValueError, match=r"`visible` must have the shape \(5, 5, 60, 54\)"):
        write_hci(light_field, tmp_path, visible=np.zeros((1, 1, 60, 54), bool))
    huge = eqx.tree_at(lambda s: s.truth.view_ids, light_field, light_field.truth.view_ids + 65535)
    with pytest.raises(ValueError, match="object ids from 0 to 65535"):
        write_hci(huge, tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        write_hci(light_field, tmp_path / "file")


def test_truth_with_gaps_is_refused(light_field, tmp_path):
    gap = eqx.tree_at(
        lambda f: f.truth.valid, light_field, light_field.truth.valid.at[3, 4].set(False)
    )
    with pytest.raises(ValueError, match="unknown at 1 pixels"):
        write_hci(gap, tmp_path / "scene")
    assert not (tmp_path / "scene").exists()
