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


@pytest.mark.parametrize("radius", [0.0, 1.0, 1.5, 3.7])
@pytest.mark.parametrize("shape", [(23, 31), (1, 19)])
def test_band_is_a_distance_from_the_edges(shape, radius):
    truth = _truth(shape)
    distance = ndimage.distance_transform_edt(~_edges(truth, 0.4))
    band = edge_band(jnp.asarray(truth), threshold=0.4, radius=radius)
    np.testing.assert_array_equal(band, distance <= radius + 1e-9)
    assert 0 < band.sum() < band.size


def test_unknown_and_masked_pixels_make_no_edges():
    truth = jnp.zeros((9, 9)).at[4, 4].set(jnp.nan).at[2, 2].set(5.0)
    assert edge_band(truth, radius=1.0).sum() == 10  # three edge pixels in an L, widened by 1 px
    mask = jnp.ones((9, 9), bool).at[2, 2].set(False)
    assert not edge_band(truth, mask=mask).any()


def test_strength_is_infinite_next_to_values_that_are_not_finite():
    disparity = jnp.zeros((3, 4)).at[1, 2].set(jnp.nan)
    strength = depth_steps(disparity, jnp.ones((3, 4), bool))
    expected = np.zeros((3, 4))
    expected[1, 1] = expected[0, 2] = expected[1, 2] = np.inf
    np.testing.assert_array_equal(strength, expected)
