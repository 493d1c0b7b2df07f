"""The crosshair in the bits of its files is that of the light field."""

import numpy as np
import pytest
from datasets.layouts import random_views, write_hci
from numpy.testing import assert_array_equal

from mvedge_jax.datasets import load_light_field
from mvedge_jax.datasets.stored import load_stored_views
from mvedge_jax.tiles import Window


@pytest.mark.parametrize("flips", [{}, {"flip_u": True}, {"flip_v": True, "swap_axes": True}])
def test_views_are_those_of_the_light_field(tmp_path, flips):
    folder = write_hci(tmp_path / "scene", random_views((3, 3, 16, 20, 3)))
    stored, field = load_stored_views(folder, **flips), load_light_field(folder, **flips)
    assert {plane.dtype for plane in stored.planes.values()} == {np.dtype(np.uint8)}
    assert stored.shape == field.views.shape[:4]
    part, cross = stored.window(Window(0, 0, 16, 20)), np.asarray(stored.available)
    assert cross.sum() == 5
    assert_array_equal(part.views[cross], field.views[cross])
    with pytest.raises(ValueError, match="The crosshair of the light field"):
        load_stored_views(folder, max_gb=1e-6)


def test_a_black_view_is_named(tmp_path):
    views = random_views((3, 3, 16, 20, 3))
    views[1, 2] = 0
    with pytest.warns(UserWarning, match=r"input_Cam005.png is black"):
        stored = load_stored_views(write_hci(tmp_path / "dark", views))
    assert not stored.available[1, 2]
