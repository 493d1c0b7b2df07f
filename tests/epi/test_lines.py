"""Lines in EPIs: fitted to edge maps, merged over scales."""

import jax
import jax.numpy as jnp
import numpy as np
from epi.slices import VIEWS, WIDTH, epi_lines, smooth, step

from mvedge_jax.epi import (
    FilterBank,
    bank_radius,
    epi_edge_map,
    fit_lines,
    merge_scales,
    prewitt_bank,
)
from mvedge_jax.epi._lines import _vertex

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


def test_the_vertex_of_a_parabola_is_found_between_filters_of_any_spacing():
    disparity = np.array([-2.0, -1.0, -0.5, 0.0, 0.25, 1.0])

    def vertex(response, best):
        response = jnp.asarray(response, float)[None]
        return float(_vertex(response, jnp.asarray([best]), jnp.asarray(disparity))[0])

    for place in (1.0, 1.2, 2.49, 3.0, 3.7):
        response = 5 - 0.3 * (np.arange(6) - place) ** 2
        found = vertex(response, np.argmax(response))
        np.testing.assert_allclose(found, np.interp(place, np.arange(6), disparity), rtol=1e-12)
    # No parabola: at the ends of the bank, and where all filters answer alike.
    for response, best in (([9, 5, 4, 3, 2, 1], 0), ([1, 2, 3, 4, 5, 9], 5), ([7] * 6, 2)):
        assert vertex(response, best) == disparity[best]


def test_interpolated_disparities_are_closer_than_the_filters():
    rng = np.random.default_rng(1)
    truth, errors = rng.uniform(-0.9, 0.9, 40), []
    maps = jax.jit(lambda epi: [epi_edge_map(epi, BANK, interpolate=i) for i in (False, True)])
    for disparity in truth:
        epi = jnp.asarray(smooth((50 * step(rng.uniform(25, 38), disparity))[..., None]))
        (confidence, coarse), (again, fine) = maps(epi)
        np.testing.assert_array_equal(again, confidence)
        at = VIEWS // 2, int(jnp.argmax(confidence[VIEWS // 2]))
        errors.append([abs(float(a[at]) - disparity) for a in (coarse, fine)])
    filters, between = np.mean(errors, axis=0)
    assert between < 0.6 * filters


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
    np.testing.assert_allclose(slope, (after - before) / 2e-7, rtol=1e-5)
    assert not jax.grad(lambda taps: disparity(taps, interpolate=False))(BANK.taps).any()


def test_slots_that_run_out_are_counted():
    confidence = jnp.zeros((3, 30)).at[1, ::5].set(jnp.arange(6.0) + 1)
    lines, left = fit_lines(confidence, jnp.zeros((3, 30)), jnp.asarray(1.0), capacity=4)
    assert int(left) == 2
    np.testing.assert_allclose(lines.position, [25, 20, 15, 10])
    np.testing.assert_allclose(lines.confidence, [6, 5, 4, 3])


def test_merging_keeps_only_what_the_fine_scale_lacks():
    fine = epi_lines([20.0, 40.0], [0.5, 0.0])
    # The same line; one that crosses the second; one of its own; and an empty slot.
    coarse = epi_lines([9.75, 19.75, 27.0, 5.0], [0.25, 0.5, 0.1, 0.0])
    coarse = coarse._replace(valid=jnp.asarray([True, True, True, False]))
    merged = merge_scales(fine, coarse, jnp.asarray(1.8), views=VIEWS)
    np.testing.assert_array_equal(merged.valid, [True, True, False, False, True, False])
    np.testing.assert_allclose(merged.position[4], 54.5)
    np.testing.assert_allclose(merged.disparity[4], 0.2)
