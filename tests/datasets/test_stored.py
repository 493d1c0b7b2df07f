"""The crosshair in the bits of its files is that of the light field."""

import numpy as np
import pytest
from datasets.layouts import write_hci

from mvedge_jax.datasets import load_light_field
from mvedge_jax.datasets.stored import load_stored_views
from mvedge_jax.tiles import Window


@pytest.fixture
def folder(tmp_path):
    views = np.random.default_rng(0).integers(0, 255, (3, 3, 16, 20, 3)).astype(np.uint8)
    return write_hci(tmp_path / "scene", views)


@pytest.mark.parametrize("flips", [{}, {"flip_u": True}, {"flip_v": True, "swap_axes": True}])
def test_views_are_those_of_the_light_field(folder, flips):
    stored, field = load_stored_views(folder, **flips), load_light_field(folder, **flips)
    assert {plane.dtype for plane in stored.planes.values()} == {np.dtype(np.uint8)}
    assert stored.shape == field.views.shape[:4]
    part, cross = stored.window(Window(0, 0, 16, 20)), np.asarray(stored.available)
    assert cross.sum() == 5
    np.testing.assert_array_equal(np.asarray(part.views)[cross], np.asarray(field.views)[cross])


def test_a_black_view_is_named(folder):
    views = np.random.default_rng(0).integers(0, 255, (3, 3, 16, 20, 3)).astype(np.uint8)
    views[1, 2] = 0
    dark = write_hci(folder.parent / "dark", views)
    with pytest.warns(UserWarning, match=r"input_Cam005.png is black"):
        stored = load_stored_views(dark)
    assert not stored.available[1, 2]


def test_a_limit_of_memory(folder):
    with pytest.raises(ValueError, match="The crosshair of the light field"):
        load_stored_views(folder, max_gb=1e-6)
