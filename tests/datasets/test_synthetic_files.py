"""A rendered light field, written in the HCI layout and read back."""

from typing import Any

import cv2
import equinox as eqx
import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mvedge_jax.datasets import load_light_field, synthetic, write_hci
from mvedge_jax.lightfield import LightField

SHAPE = (5, 5, 60, 54)


@pytest.fixture(scope="module")
def light_field() -> Any:
    return synthetic.render(synthetic.scene("edges"), shape=SHAPE, samples=1, key=jax.random.key(0))


def stored(file):
    image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image


def test_everything_comes_back_and_files_are_the_benchmarks(light_field, tmp_path):
    folder, visible, done = tmp_path / "deep" / "scene", np.zeros(SHAPE, bool), []
    visible[3, 2] = True
    write_hci(light_field, folder, visible=visible, progress=lambda k, n: done.append((k, n)))
    assert (done[0], done[-1]) == ((1, 25), (25, 25))
    back: Any = load_light_field(folder)
    assert back.views.shape == (*SHAPE, 3)
    assert_allclose(back.views, light_field.views, atol=0.5 / 255 + 1e-6)
    for name in ("disparity", "valid", "object_ids", "view_disparity", "view_ids"):
        assert_array_equal(getattr(back.truth, name), getattr(light_field.truth, name))
    for name in ("focal_px", "baseline", "focus_distance"):
        found, wanted = (getattr(field.camera, name) for field in (back, light_field))
        assert_allclose(found, wanted, rtol=1e-6)
    assert_allclose(back.disparity_range, light_field.disparity_range, rtol=1e-6)
    # View 013 of a 5x5 grid is row 2, column 3; OpenCV has blue first.
    image = stored(folder / "input_Cam013.png")[..., ::-1] / 255
    assert_allclose(image, light_field.views[2, 3], atol=0.0021)
    assert stored(folder / "objectids_lowres.png").dtype == np.uint16
    for number, value in ((17, 255), (0, 0)):
        mask = stored(folder / f"visible_Cam{number:03d}.png")
        assert_array_equal(mask, np.full(SHAPE[2:], value, np.uint8))
    assert len(list(folder.glob("input_Cam*.png"))) == 25


def test_missing_views_and_unknowns_are_left_out(light_field, tmp_path):
    available = np.zeros(SHAPE[:2], bool)
    available[2], available[:, 2] = True, True
    views = np.where(available[..., None, None, None], np.asarray(light_field.views), 0)
    write_hci(LightField(views, available=available), tmp_path)
    cross = {f"input_Cam{k:03d}.png" for k in (2, 7, 10, 11, 12, 13, 14, 17, 22)}
    assert {path.name for path in tmp_path.iterdir()} == cross | {"parameters.cfg"}
    back = load_light_field(tmp_path)
    assert_array_equal(back.available, available)
    assert back.truth is None
    assert back.camera is None


def test_mistakes_are_explained(light_field, tmp_path):
    def changed(of, change):
        return eqx.tree_at(of, light_field, change(of(light_field)))

    huge = changed(lambda f: f.truth.view_ids, lambda ids: ids + 65535)
    gap = changed(lambda f: f.truth.valid, lambda valid: valid.at[3, 4].set(False))
    small = np.zeros((1, 1, 60, 54), bool)
    cases: list[tuple[Any, dict[str, Any], str]] = [
        (gap, {}, "unknown at 1 pixels"),
        (light_field, {"visible": small}, r"`visible` must have the shape \(5, 5, 60, 54\)"),
        (huge, {}, "object ids from 0 to 65535"),
    ]
    for field, options, match in cases:
        with pytest.raises(ValueError, match=match):
            write_hci(field, tmp_path / "scene", **options)
        assert field is not gap or not (tmp_path / "scene").exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        write_hci(light_field, tmp_path / "file")
