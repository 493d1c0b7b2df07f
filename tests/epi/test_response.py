"""Filter responses and their parts against plain NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from edges.scenes import plane
from helpers import check_gradient, check_modes, dot
from scipy import signal

from mvedge_jax.color import srgb_to_lab
from mvedge_jax.epi import FilterBank, bank_radius, prewitt_bank, strongest_response
from mvedge_jax.epi._response import bank_response, correlate


@pytest.fixture(scope="module")
def rows_and_taps():
    key = jax.random.split(jax.random.key(0))
    return (
        jax.random.normal(key[0], (3, 14, 4), jnp.float64),
        jax.random.normal(key[1], (5, 4, 7), jnp.float64),
    )


def test_correlation_is_that_of_scipy(rows_and_taps):
    rows, taps = map(np.asarray, rows_and_taps)
    found = np.asarray(correlate(*rows_and_taps))
    for b, k in np.ndindex(3, 5):
        oracle = sum(signal.correlate(rows[b, :, i], taps[k, i], "valid") for i in range(4))
        np.testing.assert_allclose(found[b, :, k], oracle, atol=1e-12)


def test_transposes_of_the_correlation_are_transposes(rows_and_taps):
    rows, taps = rows_and_taps
    out = jax.random.normal(jax.random.key(1), (3, 8, 5), jnp.float64)
    value, pull = jax.vjp(correlate, rows, taps)
    back_rows, back_taps = pull(out)
    forward = dot(value, out)
    np.testing.assert_allclose(dot(back_rows, rows), forward, rtol=1e-12)
    np.testing.assert_allclose(dot(back_taps, taps), forward, rtol=1e-12)


def test_second_derivatives_of_the_correlation_agree_with_differences(rows_and_taps):
    def loss(tree):
        return jnp.sum(jnp.sin(correlate(*tree)))

    check_modes(loss, rows_and_taps, rtol=1e-6, key=jax.random.key(2))


def test_correlation_under_vmap_is_a_loop(rows_and_taps):
    rows, taps = rows_and_taps
    many = jnp.stack([taps, 2 * taps])

    def slope(taps):
        return jax.grad(lambda t: jnp.sum(correlate(rows, t) ** 2))(taps)

    np.testing.assert_allclose(
        jax.vmap(slope)(many), jnp.stack([slope(t) for t in many]), rtol=1e-12
    )


def test_the_strongest_response_is_that_of_the_bank():
    arm = srgb_to_lab(plane(0.5, size=(19, 27), dtype=jnp.float64).horizontal_arm)
    bank = prewitt_bank(jnp.linspace(-0.2, 1.2, 15, dtype=jnp.float64), 5, bank_radius(1.2, 5))
    response = np.asarray(bank_response(arm, bank))
    np.testing.assert_allclose(
        strongest_response(arm, bank), np.sqrt((response**2).sum(2)).max(-1), atol=1e-9
    )


def test_the_strongest_response_is_differentiable_in_views_and_taps():
    # Random taps: no two filters answer alike, as they do where borders are repeated.
    key = jax.random.split(jax.random.key(3))
    arm = jax.random.normal(key[0], (5, 6, 17, 3))
    taps = jax.random.normal(key[1], (4, 5, 7))

    def loss(tree):
        arm, taps = tree
        return jnp.sum(jnp.sin(0.1 * strongest_response(arm, FilterBank(jnp.arange(4.0), taps))))

    check_gradient(loss, (arm, taps), rtol=1e-6, step=1e-6, directions=2, key=key[0])
    flat = jnp.zeros_like(arm)
    bank = prewitt_bank(jnp.linspace(0.0, 1.0, 5), 5, bank_radius(1.0, 5))
    assert not jnp.any(jax.grad(lambda a: jnp.sum(strongest_response(a, bank)))(flat))
