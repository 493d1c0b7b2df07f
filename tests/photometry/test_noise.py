"""The noise of a scene: recovered where it is known, undisturbed by clipping, differentiable."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, lean
from photometry.scenes import changed, of_crosshair, textured

from mvedge_jax._crosshair import Arm, Crosshair, crosshair
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry.brightness import measure_noise
from mvedge_jax.photometry.matching._unexplained import between_views_variance

TRIED = jnp.linspace(-1, 1, 17)


def _measured(light_field, scale=1.0, *, arms=None, tried=TRIED):
    scale = jnp.asarray(scale, light_field.views.dtype)
    arms = crosshair(light_field) if arms is None else arms
    between = between_views_variance(
        arms.mapped(lambda planes: planes * scale), tried.astype(scale.dtype)
    )
    center = jnp.moveaxis(light_field.center_view * scale, -1, 0)
    return measure_noise(center, scale, between=between)


def _single(image, scale=1.0):
    """Of one view by itself, `[c, y, x]`."""
    return measure_noise(image, jnp.asarray(scale, image.dtype))


@pytest.fixture(scope="module")
def noisy():
    return changed(textured(), noise=0.02)


@pytest.mark.parametrize("sigma", [0.01, 0.05])
def test_known_noise_is_recovered_from_arms_from_any_set_of_views_and_from_one(sigma):
    field = changed(textured(), noise=sigma)
    center = jnp.moveaxis(field.center_view, -1, 0)
    between = lean(between_views_variance)(of_crosshair(field), TRIED.astype(center.dtype))
    of_set = measure_noise(center, jnp.float32(1), between=between)
    for found, bar in ((_measured(field), 0.1), (of_set, 0.1), (_single(center), 0.12)):
        assert abs(float(found.deviation) / sigma - 1) < bar


def test_noise_is_that_of_the_longer_arm_whatever_the_shape_of_its_views():
    tall = changed(textured(), noise=0.02).views[:, 1:-1]
    tried = jnp.linspace(-0.5, 1, 7, dtype=tall.dtype)
    found = [
        between_views_variance(crosshair(LightField(views)), tried, finer=2)
        for views in (tall, jnp.transpose(tall, (1, 0, 3, 2, 4)))
    ]
    assert float(found[0]) == pytest.approx(float(found[1]), rel=1e-6)


def test_clean_views_have_the_noise_of_their_bits_and_no_alpha():
    found = _measured(changed(textured()))
    assert float(found.alpha) == 0
    assert float(found.deviation) < 1 / 255
    dark = _measured(changed(textured(), factor=0.1), scale=10.0)
    assert float(dark.deviation) >= 10 / 255 / 12**0.5 - 1e-6
    assert float(dark.alpha) > 0.8


def test_clipped_pixels_and_missing_views_have_no_say(noisy):
    views = changed(textured(low=0.3), noise=0.02).views
    views = views.at[..., :60, :].set(1.0).at[..., :40, :, :].set(0.0)
    found = [_single(jnp.moveaxis(views[2, 2], -1, 0))]
    own = crosshair(noisy)[0]
    for value in (0.0, 0.7):
        planes, there = own.planes.at[0].set(value), own.available.at[0].set(False)
        arm = own._replace(planes=planes, available=there)
        found.append(_measured(noisy, arms=Crosshair(arm, arm)))
    assert float(found[1].deviation) == float(found[2].deviation)
    for each in found:
        assert abs(float(each.deviation) / 0.02 - 1) < 0.15


@pytest.mark.parametrize("shape", [(3, 8, 40), (3, 9, 9), (3, 12, 17)])
def test_small_and_odd_images_give_at_least_the_quantization(shape):
    found = _single(jnp.full(shape, 128 / 255, jnp.float32))
    assert float(found.deviation) == pytest.approx(1 / 255 / 12**0.5)


@pytest.mark.parametrize("exposure", [1.0, 3.7])
@pytest.mark.parametrize(
    ("levels", "expected"), [(255, 255), (1023, 1023), (65535, 2550), (None, 2550)]
)
def test_the_step_of_the_views_is_found_in_them(levels, expected, exposure):
    image = jax.random.uniform(jax.random.key(0), (3, 24, 24), jnp.float32)
    if levels is not None:
        image = jnp.round(levels * image) / levels
    rounding = float(_single(image * exposure, exposure).rounding)
    assert rounding == pytest.approx(1 / expected / 12**0.5, rel=1e-6)


def test_gradient_and_jit():
    field = changed(textured(size=(32, 40), dtype=np.float64), noise=0.02, bits=False)

    def deviation(views):
        return _measured(type(field)(views), tried=TRIED[::4]).deviation

    check_gradient(deviation, field.views, rtol=1e-4, step=1e-7, key=jax.random.key(0))
    found = deviation(field.views), jax.jit(deviation)(field.views)
    np.testing.assert_allclose(*found, rtol=1e-10)


def test_texture_as_fine_as_pixels_is_no_noise():
    """Between two hypotheses, half a pixel apart in the outermost view, it looks like noise."""
    views, width, pad = 3, 96, 8
    frequency = np.fft.fftfreq(width + 2 * pad)
    spectrum = np.fft.fft2(np.random.default_rng(0).standard_normal(2 * (width + 2 * pad,)))
    spectrum *= np.exp(-((np.hypot(*np.meshgrid(frequency, frequency)) / 0.38) ** 8))
    rows = []
    for u in range(views):
        # At a disparity a quarter of a pixel away from the nearest hypotheses.
        moved = spectrum * np.exp(-2j * np.pi * frequency * 0.25 * (u - 1))
        picture = np.fft.ifft2(moved).real[pad:-pad, pad:-pad]
        rows.append(np.round(255 * (0.5 + 0.12 * picture.clip(-3, 3))) / 255)
    planes = jnp.asarray(np.stack(rows)[:, None].repeat(3, 1), jnp.float32)
    arm = Arm(planes, jnp.float32([1.0, 0.0, -1.0]), jnp.ones(views, bool))
    tried, arms = jnp.linspace(-2, 2, 9, dtype=jnp.float32), Crosshair(arm, arm)
    found, coarse = (
        measure_noise(
            planes[1], jnp.float32(1), between=between_views_variance(arms, tried, finer=finer)
        )
        for finer in (4, 1)
    )
    assert float(found.alpha) == 0
    assert float(found.deviation) < 0.5 * float(coarse.deviation)
