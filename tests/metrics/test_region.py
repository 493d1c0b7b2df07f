"""Depth edges and the band around them: against SciPy's distance transform."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from mvedge_jax.metrics import edge_band
from mvedge_jax.metrics._region import depth_steps


def _truth(shape):
    rng = np.random.default_rng(1)
    return np.repeat(np.repeat(rng.random((4, 5)), 6, 0), 7, 1)[: shape[0], : shape[1]]


def _edges(truth, threshold):
    """Pixels that jump to their right or lower neighbour, in plain loops."""
    edges = np.zeros(truth.shape, bool)
    for y, x in np.ndindex(truth.shape):
        for b, a in ((y, x + 1), (y + 1, x)):
            if b < truth.shape[0] and a < truth.shape[1]:
                edges[y, x] |= abs(truth[y, x] - truth[b, a]) > threshold
    return edges


@pytest.mark.parametrize(("shape", "radius"), [((23, 31), 0.0), ((23, 31), 3.7), ((1, 19), 1.5)])
def test_band_is_a_distance_from_the_edges(shape, radius):
    truth = _truth(shape)
    distance = ndimage.distance_transform_edt(~_edges(truth, 0.4))
    band = edge_band(jnp.asarray(truth), threshold=0.4, radius=radius)
    np.testing.assert_array_equal(band, distance <= radius + 1e-9)
    assert 0 < band.sum() < band.size


def test_unknown_and_masked_pixels_make_no_edges():
    truth, mask = np.zeros((9, 9)), np.ones((9, 9), bool)
    truth[4, 4], truth[2, 2], mask[2, 2] = np.nan, 5.0, False
    band = np.asarray(edge_band(jnp.asarray(truth), radius=1.0))
    assert band.sum() == 10  # three edge pixels in an L, widened by 1 px
    masked = edge_band(jnp.asarray(truth), mask=jnp.asarray(mask), radius=1.0)
    assert not np.asarray(masked).any()


def test_strength_is_infinite_next_to_values_that_are_not_finite():
    disparity = jnp.zeros((3, 4)).at[1, 2].set(jnp.nan)
    strength = depth_steps(disparity, jnp.ones((3, 4), bool))
    expected = np.zeros((3, 4))
    expected[1, 1] = expected[0, 2] = expected[1, 2] = np.inf
    np.testing.assert_array_equal(strength, expected)
