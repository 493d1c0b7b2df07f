"""Which surface a pixel beside a step shows."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mvedge_jax.all_views._draw import decided, drawn
from mvedge_jax.all_views._samples import samples_of
from mvedge_jax.warping import Outline


def _encoded(linear):
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


@jax.jit
def _drawn(view):
    """A map whose front ends after column 12, how it is drawn, and what a view makes of it."""
    disparity = jnp.asarray(np.tile(np.where(np.arange(24) < 13, 1.0, 0.0), (16, 1)))
    samples = samples_of(disparity, jnp.full_like(disparity, 0.01), capacity=1)
    drawing = drawn(samples, jnp.zeros(2), (16, 24))
    odds = Outline(odds=jnp.asarray(0.25))
    found = decided(drawing, samples, view, jnp.asarray(0.0), odds)
    return samples.disparity, drawing.sample, found.sample


@pytest.mark.parametrize(("front", "back"), [(0.6, 0.02), (0.02, 0.6)])
@pytest.mark.parametrize("share", [0.4, 0.6])
def test_a_pixel_belongs_to_what_covers_most_of_it_in_linear_light(front, back, share):
    # The front covers a share of column 12.
    light = np.full((16, 24), back)
    light[:, :12], light[:, 12] = front, share * front + (1 - share) * back
    disparity, _, found = _drawn(jnp.asarray(np.repeat(_encoded(light)[None], 3, 0)))
    expected = np.where(np.arange(24) < (13 if share > 0.5 else 12), 1.0, 0.0)
    np.testing.assert_array_equal(disparity[found], np.tile(expected, (16, 1)))


def test_where_nothing_tells_the_drawing_stays():
    _, drawing, found = _drawn(jnp.full((3, 16, 24), 0.5))
    np.testing.assert_array_equal(found, drawing)
