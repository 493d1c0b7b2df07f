"""Splines against SciPy, the vertex of a parabola."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from mvedge_jax.interpolation import (
    cubic_taps,
    exact_shift,
    spline_coefficients,
    spline_noise,
    vertex,
)


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


@pytest.mark.parametrize("size", [0.0, 1e-30, 1e-12, 1e-9, 1e-6, 1e30])
def test_flat_values_of_any_size_have_finite_derivatives(size):
    values = jnp.full(3, size, jnp.float32)
    first = jax.grad(lambda v: vertex(*v))(values)
    second = jax.hessian(lambda v: vertex(*v))(values)
    assert bool(jnp.isfinite(first).all())
    assert bool(jnp.isfinite(second).all())


def test_nearly_equal_values_have_no_steep_vertex():
    # Views of 8 bits tie exactly; a step of an optimizer leaves them this far apart.
    for bend in (0.0, 1e-9, 1e-7, 1e-5, 1e-3):
        values = [jnp.asarray(1 + x) for x in (-bend, 0.0, -1.5 * bend)]
        slopes = jax.grad(lambda v: vertex(*v))(values)
        assert max(float(jnp.abs(s)) for s in slopes) < 2e3
    offsets = [
        float(vertex(*(jnp.asarray(1 + x) for x in (-b, 0.0, -1.5 * b)))) for b in (1e-6, 1e-4)
    ]
    assert abs(offsets[0]) < 1e-3 < abs(offsets[1])


@pytest.mark.parametrize("fraction", [0.0, 0.3, 0.5])
def test_noise_of_interpolated_values_is_that_of_white_noise(fraction):
    noise = np.random.default_rng(0).standard_normal((300, 300))
    coefficients = np.asarray(spline_coefficients(jnp.asarray(noise), axis=-1))
    weights, _ = cubic_taps(jnp.asarray(fraction))
    shifted = np.stack([coefficients[:, j : j + 290] for j in range(4)])
    values = np.tensordot(np.asarray(weights), shifted, 1)
    assert float(spline_noise(weights)) == pytest.approx(values.var(), rel=0.03)


def test_exact_shifts_add_to_any_column_without_rounding():
    shift = np.random.default_rng(3).uniform(-8, 8, 1000)
    for dtype, step in ((np.float32, 2.0**-10), (np.float64, 2.0**-39)):
        moved = exact_shift(jnp.asarray(shift, dtype))
        assert float(jnp.abs(moved - shift.astype(dtype)).max()) <= step / 2
        for column in (5, 701, 16000):
            np.testing.assert_array_equal((column + moved) - column, moved)
    np.testing.assert_array_equal(jax.grad(lambda s: (s * exact_shift(s)).sum())(moved), 2 * moved)
