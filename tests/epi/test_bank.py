"""Banks of filters and their responses against plain NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from edges.scenes import plane
from epi.slices import VIEWS, WIDTH, epi_lines, smooth, step
from helpers import check_gradient, check_modes, dot
from numpy.testing import assert_allclose, assert_array_equal
from scipy import signal

from mvedge_jax.color import srgb_to_lab
from mvedge_jax.epi import (
    FilterBank,
    bank_radius,
    epi_edge_map,
    exponential_disparities,
    fit_lines,
    merge_scales,
    prewitt_bank,
    strongest_response,
)
from mvedge_jax.epi._lines import _suppressed, _vertex
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


BANK = prewitt_bank(jnp.asarray(np.arange(-6, 7) * 0.2), VIEWS, bank_radius(1.2, VIEWS))


def test_a_flat_epi_has_no_lines_and_a_step_has_one():
    bank = prewitt_bank(jnp.asarray(np.arange(-10, 11) * 0.1), VIEWS, bank_radius(1.0, VIEWS))
    for epi, expected in ((np.full((VIEWS, WIDTH), 30.0), 0), (50 * step(31.3, 0.6), 1)):
        for modulate in (False, True):
            confidence, slope = epi_edge_map(
                jnp.asarray(smooth(epi[..., None])), bank, modulate=modulate
            )
            confidence = jnp.where(confidence > 1e-6, confidence, 0)
            lines, left = fit_lines(confidence, slope, jnp.asarray(1.8), capacity=8)
            strong = np.asarray(lines.valid & (lines.confidence > 0.5 * lines.confidence.max()))
            assert strong.sum() == expected
            assert int(left) == 0
            if expected:
                assert abs(float(lines.position[0]) - 31.3) < 1
                assert abs(float(lines.disparity[0]) - 0.6) < 0.15


def test_every_channel_is_suppressed_across_its_lines():
    # A line of lightness and one of color, 2 px apart.
    epi = np.stack([50 * step(31.3, 0.6), 20 * step(33.3, 0.6)], -1)
    confidence, slope = epi_edge_map(jnp.asarray(smooth(epi)), BANK)
    steps = VIEWS // 2 - np.arange(VIEWS)
    for row in range(2, VIEWS - 2):
        found = np.flatnonzero(confidence[row] > 1)
        expected = np.array([31.3, 33.3]) + steps[row] * 0.6
        apart = np.abs(found[:, None] - expected[None])
        assert apart.min(0).max() < 0.75
        assert apart.min(1).max() < 0.75
        assert_allclose(np.asarray(slope)[row, found], 0.6, atol=0.21)


def test_suppression_compares_pixels_along_the_normal():
    rng = np.random.default_rng(0)
    value, slope = rng.normal(size=(5, 9, 2)), rng.uniform(-2, 2, (5, 9, 2))
    found = np.asarray(_suppressed(jnp.asarray(value), jnp.asarray(slope)))
    for u, x, c in np.ndindex(3, 7, 2):
        at = u + 1, x + 1
        own = slope[(*at, c)]
        share, sign = 2 * np.arctan(abs(own)) / np.pi, 1 if own > 0 else -1
        beside = []
        for side in (-1, 1):
            straight = (side * sign, 0) if abs(own) > 1 else (0, side)
            diagonal = value[at[0] + side * sign, at[1] + side, c]
            along = value[at[0] + straight[0], at[1] + straight[1], c]
            beside.append((1 - share) * along + share * diagonal)
        assert found[(*at, c)] == (value[(*at, c)] if value[(*at, c)] > max(beside) else 0)


def test_the_vertex_of_a_parabola_is_found_between_filters_of_any_spacing():
    disparity = np.array([-2.0, -1.0, -0.5, 0.0, 0.25, 1.0])

    def vertex(response, best):
        response = jnp.asarray(response, float)[None, None]
        return float(_vertex(response, jnp.asarray([[best]]), jnp.asarray(disparity))[0, 0])

    for place in (1.0, 1.2, 2.49, 3.0, 3.7):
        response = 5 - 0.3 * (np.arange(6) - place) ** 2
        found = vertex(response, np.argmax(response))
        assert_allclose(found, np.interp(place, np.arange(6), disparity), rtol=1e-12)
    # No parabola: at the ends of the bank, and where all filters answer alike.
    for response, best in (([9, 5, 4, 3, 2, 1], 0), ([1, 2, 3, 4, 5, 9], 5), ([7] * 6, 2)):
        assert vertex(response, best) == disparity[best]


def test_interpolated_disparities_have_the_derivative_of_differences_in_the_taps():
    epi = jnp.asarray(smooth((50 * step(31.3, 0.28))[..., None]))
    confidence, _ = epi_edge_map(epi, BANK)
    at = np.unravel_index(int(jnp.argmax(confidence)), confidence.shape)

    def disparity(taps, interpolate=True):
        changed = FilterBank(BANK.disparity, taps)
        return epi_edge_map(epi, changed, interpolate=interpolate)[1][at]

    direction = jnp.asarray(np.random.default_rng(3).normal(size=BANK.taps.shape))
    slope = jnp.vdot(jax.grad(disparity)(BANK.taps), direction)
    before, after = (disparity(BANK.taps + h * direction) for h in (-1e-7, 1e-7))
    assert abs(float(slope)) > 1e-3
    assert_allclose(slope, (after - before) / 2e-7, rtol=1e-5)
    assert not jax.grad(lambda taps: disparity(taps, interpolate=False))(BANK.taps).any()


def test_slots_that_run_out_are_counted():
    confidence = jnp.zeros((3, 30)).at[1, ::5].set(jnp.arange(6.0) + 1)
    lines, left = fit_lines(confidence, jnp.zeros((3, 30)), jnp.asarray(1.0), capacity=4)
    assert int(left) == 2
    assert_allclose(lines.position, [25, 20, 15, 10])
    assert_allclose(lines.confidence, [6, 5, 4, 3])


def test_merging_keeps_only_what_the_fine_scale_lacks():
    fine = epi_lines([20.0, 40.0], [0.5, 0.0])
    # The same line; one that crosses the second; one of its own; and an empty slot.
    coarse = epi_lines([9.75, 19.75, 27.0, 5.0], [0.25, 0.5, 0.1, 0.0])
    coarse = coarse._replace(valid=jnp.asarray([True, True, True, False]))
    merged = merge_scales(fine, coarse, jnp.asarray(1.8), views=VIEWS)
    assert_array_equal(merged.valid, [True, True, False, False, True, False])
    assert_allclose(merged.position[4], 54.5)
    assert_allclose(merged.disparity[4], 0.2)
