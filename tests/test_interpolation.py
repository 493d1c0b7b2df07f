"""Splines against SciPy, the vertex of a parabola."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from mvedge_jax.interpolation import spline_coefficients, vertex


@pytest.mark.parametrize("axis", [0, -1])
def test_coefficients_are_those_of_scipy(axis):
    values = np.random.default_rng(1).normal(size=(30, 31))
    coefficients = np.asarray(spline_coefficients(jnp.asarray(values), axis=axis))
    oracle = ndimage.spline_filter1d(values, order=3, axis=axis, mode="mirror")
    np.testing.assert_allclose(coefficients, oracle, atol=3e-6)


def test_vertex_of_a_parabola():
    x = np.array([-1.0, 0.0, 1.0])
    for top in (-0.4, 0.0, 0.7):
        values = [jnp.asarray(3.0 - 2 * (at - top) ** 2) for at in x]
        np.testing.assert_allclose(vertex(*values), top, atol=1e-12)
    assert float(vertex(*[jnp.asarray(1.0)] * 3)) == 0.0
