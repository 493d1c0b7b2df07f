"""Lines in EPIs: fitted to edge maps, merged over scales."""

import jax.numpy as jnp
import numpy as np
from epi.slices import VIEWS, WIDTH, epi_lines, smooth, step

from mvedge_jax.epi import (
    bank_radius,
    epi_edge_map,
    fit_lines,
    merge_scales,
    prewitt_bank,
)


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
