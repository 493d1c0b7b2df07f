"""The search and its parts against plain NumPy."""

import jax.numpy as jnp
import numpy as np
from epi.scenes import plane
from scipy import ndimage

from mvedge_jax.color import srgb_to_gray, srgb_to_lab
from mvedge_jax.epi import bank_radius, bank_response, noise_variance, prewitt_bank
from mvedge_jax.epi._search import _line_taps, _variance, search, vertex
from mvedge_jax.epi._spline import spline_coefficients, spline_slope, spline_weight


def test_variance_by_convolution_equals_the_variance_of_interpolated_samples():
    rng = np.random.default_rng(0)
    views, width, radius = 5, 40, 7
    rows = rng.normal(size=(2, width, views))
    disparity = np.array([-1.3, 0.0, 0.45, 2.0])
    taps = _line_taps(jnp.asarray(disparity), views, radius)
    found = np.asarray(_variance(jnp.asarray(rows), jnp.ones((width, views)), taps, radius))
    x = np.arange(radius, width - radius)
    for k, d in enumerate(disparity):
        samples = np.stack(
            [
                [np.interp(x + (views // 2 - u) * d, np.arange(width), row[:, u]) for row in rows]
                for u in range(views)
            ]
        )
        np.testing.assert_allclose(found[:, :, k], samples.var(0), atol=1e-12)


def _search(light_field, tile):
    across = light_field.horizontal_arm
    down = jnp.swapaxes(light_field.vertical_arm, 1, 2)
    disparity = jnp.asarray(np.linspace(-0.2, 1.2, 15), across.dtype)
    bank = prewitt_bank(disparity, 5, bank_radius(1.2, 5))
    maps = search(
        (srgb_to_lab(across), srgb_to_lab(down)),
        (100 * srgb_to_gray(across), 100 * srgb_to_gray(down)),
        (bank, bank),
        jnp.asarray(0.2, across.dtype),
        window=5,
        tile=tile,
    )
    return maps, bank, across, down


def test_tiles_do_not_show_and_responses_are_those_of_the_bank():
    light_field = plane(0.5, size=(19, 27), dtype=jnp.float64)
    small, bank, across, down = _search(light_field, 8)
    large, *_ = _search(light_field, 32)
    for a, b in zip(small, large, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)
    for arm, views in enumerate((across, down)):
        response = np.asarray(bank_response(srgb_to_lab(views), bank))
        strength = np.sqrt((response**2).sum(2)).max(-1)
        found = small.strength[arm] if arm == 0 else small.strength[arm].T
        np.testing.assert_allclose(found, strength, atol=1e-9)


def test_the_search_finds_the_plane_up_to_the_border():
    maps, *_ = _search(plane(0.5, size=(19, 27)), 16)
    assert np.median(np.abs(maps.disparity - 0.5)) < 0.01
    assert np.quantile(np.abs(maps.disparity - 0.5), 0.95) < 0.1


def test_vertex_of_a_parabola():
    x = np.array([-1.0, 0.0, 1.0])
    for top in (-0.4, 0.0, 0.7):
        values = [jnp.asarray(3.0 - 2 * (at - top) ** 2) for at in x]
        np.testing.assert_allclose(vertex(*values), top, atol=1e-12)
    assert float(vertex(*[jnp.asarray(1.0)] * 3)) == 0.0


def test_spline_is_that_of_scipy():
    values = np.random.default_rng(1).normal(size=(3, 30))
    coefficients = np.asarray(spline_coefficients(jnp.asarray(values), axis=-1))
    oracle = ndimage.spline_filter1d(values, order=3, axis=-1, mode="mirror")
    np.testing.assert_allclose(coefficients, oracle, atol=3e-6)
    t = np.linspace(-2.5, 2.5, 41)
    h = 1e-6
    slope = (spline_weight(jnp.asarray(t + h)) - spline_weight(jnp.asarray(t - h))) / (2 * h)
    np.testing.assert_allclose(spline_slope(jnp.asarray(t)), slope, atol=1e-8)


def test_noise_is_measured_between_the_textures():
    rng = np.random.default_rng(2)
    y, x = np.mgrid[0:96, 0:96]
    scene = 20 * np.sin(x / 9) + 15 * (y > 40)
    for sigma in (0.0, 1.0, 3.0):
        noisy = jnp.asarray(scene + rng.normal(scale=sigma, size=scene.shape))
        assert abs(float(jnp.sqrt(noise_variance(noisy))) - sigma) < 0.2 * sigma + 0.02
