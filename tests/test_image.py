"""Cubic splines against SciPy."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from mvedge_jax.image import spline_coefficients


@pytest.mark.parametrize("axis", [0, -1])
def test_coefficients_are_those_of_scipy(axis):
    values = np.random.default_rng(1).normal(size=(30, 31))
    coefficients = np.asarray(spline_coefficients(jnp.asarray(values), axis=axis))
    oracle = ndimage.spline_filter1d(values, order=3, axis=axis, mode="mirror")
    np.testing.assert_allclose(coefficients, oracle, atol=3e-6)
