"""Banks of filters and their responses against plain NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from edges.scenes import plane
from helpers import check_gradient, check_modes, dot
from numpy.testing import assert_allclose, assert_array_equal
from scipy import signal

from mvedge_jax.color import srgb_to_lab
from mvedge_jax.epi import (
    FilterBank,
    bank_radius,
    exponential_disparities,
    prewitt_bank,
    strongest_response,
)
from mvedge_jax.epi._response import bank_response, correlate

_DISPARITY = np.array([-1.7, -0.6, -0.25, 0.0, 0.33, 1.0, 2.0])


def _bank(views=5):
    return prewitt_bank(jnp.asarray(_DISPARITY), views, bank_radius(2.0, views))


def _arm(views=5, shape=(3, 21), channels=2, seed=0):
    return jax.random.normal(jax.random.key(seed), (views, *shape, channels), jnp.float64)


def _brute_force(arm, bank):
    """Plain loops over the 2-D filters, edge values beyond the border."""
    views, height, width, channels = arm.shape
    taps, radius = np.asarray(bank.taps), bank.radius
    out = np.zeros((height, width, channels, len(taps)))
    for k, y, x in np.ndindex(len(taps), height, width):
        at = np.clip(x + np.arange(2 * radius + 1) - radius, 0, width - 1)
        out[y, x, :, k] = np.einsum("uw,uwc->c", taps[k], arm[:, y, at])
    return out


def _sheared(arm, disparity):
    """Views shifted by their steps, averaged, and differenced: no taps at all."""
    steps, x = arm.shape[0] // 2 - np.arange(arm.shape[0]), np.arange(arm.shape[2])

    def mean(d, offset):
        moved = [
            np.apply_along_axis(lambda line, s=s: np.interp(x + s * d + offset, x, line), 1, view)
            for view, s in zip(arm, steps, strict=True)
        ]
        return np.mean(moved, 0)

    return np.stack([mean(d, 1) - mean(d, -1) for d in disparity], -1)


def test_explicit_taps_sheared_sum_and_brute_force_agree():
    arm, bank = _arm(), _bank()
    response = bank_response(arm, bank)
    assert_allclose(response, _sheared(np.asarray(arm), _DISPARITY), atol=1e-13)
    assert_allclose(response, _brute_force(np.asarray(arm), bank), atol=1e-13)
    # More rows than a block give the same rows.
    tall = _arm(shape=(37, 12), channels=1)
    some = bank_response(tall[:, 33:36], bank)
    assert_allclose(bank_response(tall, bank)[33:36], some, atol=1e-13)
    # A flat image has no edges, not at the borders either, where zero padding would invent one.
    assert float(jnp.abs(bank_response(jnp.full((5, 2, 11, 1), 0.7), bank)).max()) < 1e-12


@pytest.mark.parametrize("slope", [-1.7, -0.25, 0.33, 2.0])
def test_a_unit_step_answers_with_one_for_every_slope(slope):
    steps = 2 - np.arange(5)
    epi = np.clip(np.arange(41)[None] - (20 + steps * slope)[:, None] + 0.5, 0, 1)
    response = np.asarray(bank_response(jnp.asarray(epi)[:, None, :, None], _bank()))[0, 20, 0]
    own = response[slope == _DISPARITY][0]
    # A slope off by less than half a pixel at the ends still has the step between its lines.
    assert own == pytest.approx(1, abs=0.06)
    assert own >= response.max() - 0.03
    assert own > response[np.abs(_DISPARITY - slope) > 0.55].max() + 0.02


def test_response_is_differentiable_in_views_and_taps():
    weight = jax.random.normal(jax.random.key(3), (3, 21, 2, 7), jnp.float64)

    def loss(tree):
        return (weight * jnp.sin(bank_response(*tree))).sum()

    check_gradient(loss, (_arm(), _bank()), rtol=1e-7, key=jax.random.key(1))


def test_exponential_spacing_is_that_of_the_reference_notes():
    values = exponential_disparities(60, 2.0)
    assert values.shape == (59,)
    assert_allclose(values, -values[::-1], atol=1e-15)
    assert_allclose(values[-3:], [1.789, 1.893, 2.0], atol=1e-3)
    assert_allclose(np.diff(values)[29], 0.0408, atol=2e-3)


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: bank_response(jnp.zeros((3, 2, 8, 1)), _bank()), "is for 5 views, `arm` has 3"),
        (lambda: exponential_disparities(3, 2.0), "`count` must be at least 4, got 3"),
        (lambda: exponential_disparities(60, 0.0), "`reach` must be positive"),
    ],
)
def test_mistakes_are_named(call, match):
    with pytest.raises(ValueError, match=match):
        call()


def test_taps_follow_the_steps_of_the_views():
    radius = bank_radius(2.0, 7)

    def taps(steps=None, shrink=1.0):
        return prewitt_bank(jnp.asarray(shrink * _DISPARITY), 5, radius, steps=steps).taps

    even = jnp.arange(2.0, -3, -1)
    assert_array_equal(taps(even), taps())
    # Half the disparity over twice the steps is the same line.
    assert_allclose(taps(2 * even, 0.5), taps(), atol=1e-12)
    uneven = even.at[0].set(2.5).at[3].set(-1.3)
    assert_allclose(jax.jit(taps)(uneven), taps(uneven), atol=1e-15)
    # A line of disparity 2 is at 5 px in the first view: the average is ahead by 1 px, 6.
    assert int(jnp.argmax(taps(uneven)[-1, 0])) - radius == 6


def test_the_gradient_in_the_steps():
    disparity, steps = jnp.asarray([-0.63, 0.31, 1.17]), jnp.asarray([2.1, 0.9, -1.2, -2.3])
    shown = jax.random.normal(jax.random.key(1), (3, 5, 21))

    def loss(others):
        every = jnp.insert(others, 2, 0.0)
        return jnp.sum(shown * prewitt_bank(disparity, 5, 10, steps=every).taps)

    check_gradient(loss, steps, rtol=1e-6, step=1e-6, key=jax.random.key(2))


@pytest.fixture(scope="module")
def rows_and_taps():
    keys = jax.random.split(jax.random.key(0))
    return tuple(
        jax.random.normal(k, s, jnp.float64)
        for k, s in zip(keys, ((3, 14, 4), (5, 4, 7)), strict=True)
    )


def test_correlation_is_that_of_scipy_and_its_transposes_are_transposes(rows_and_taps):
    rows, taps = rows_and_taps
    found, pull = jax.vjp(correlate, rows, taps)
    for b, k in np.ndindex(3, 5):
        oracle = sum(signal.correlate(rows[b, :, i], taps[k, i], "valid") for i in range(4))
        assert_allclose(found[b, :, k], oracle, atol=1e-12)
    out = jax.random.normal(jax.random.key(1), (3, 8, 5), jnp.float64)
    for back, given in zip(pull(out), rows_and_taps, strict=True):
        assert_allclose(dot(back, given), dot(found, out), rtol=1e-12)


def test_second_derivatives_of_the_correlation_agree_with_differences(rows_and_taps):
    def loss(tree):
        return jnp.sum(jnp.sin(correlate(*tree)))

    check_modes(loss, rows_and_taps, rtol=1e-6, key=jax.random.key(2))


def test_correlation_under_vmap_is_a_loop(rows_and_taps):
    rows, taps = rows_and_taps
    many = jnp.stack([taps, 2 * taps])
    slope = jax.grad(lambda t: jnp.sum(correlate(rows, t) ** 2))
    assert_allclose(jax.vmap(slope)(many), jnp.stack([slope(t) for t in many]), rtol=1e-12)


def test_the_strongest_response_is_that_of_the_bank():
    arm = srgb_to_lab(plane(0.5, size=(19, 27), dtype=jnp.float64).horizontal_arm)
    bank = prewitt_bank(jnp.linspace(-0.2, 1.2, 15, dtype=jnp.float64), 5, bank_radius(1.2, 5))
    response = np.asarray(bank_response(arm, bank))
    expected = np.sqrt((response**2).sum(2)).max(-1)
    assert_allclose(strongest_response(arm, bank), expected, atol=1e-9)


def test_the_strongest_response_is_differentiable_in_views_and_taps():
    # Random taps: no two filters answer alike, as they do where borders are repeated.
    keys = jax.random.split(jax.random.key(3))
    arm, taps = jax.random.normal(keys[0], (5, 6, 17, 3)), jax.random.normal(keys[1], (4, 5, 7))

    def loss(tree):
        arm, taps = tree
        return jnp.sum(jnp.sin(0.1 * strongest_response(arm, FilterBank(jnp.arange(4.0), taps))))

    check_gradient(loss, (arm, taps), rtol=1e-6, step=1e-6, directions=2, key=keys[0])
    bank = prewitt_bank(jnp.linspace(0.0, 1.0, 5), 5, bank_radius(1.0, 5))
    assert not jnp.any(jax.grad(lambda a: jnp.sum(strongest_response(a, bank)))(0 * arm))
