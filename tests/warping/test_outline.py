"""Which of two surfaces a pixel beside a step shows."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mvedge_jax.warping import Outline, outline
from mvedge_jax.warping._outline import _share


def _encoded(linear):
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _outlined(disparity, light, *, prior=1.0, noise=0.0):
    view = jnp.asarray(_encoded(np.broadcast_to(light, (3, *disparity.shape))))
    shown = outline(
        jnp.asarray(disparity), view, jnp.asarray(noise), Outline(odds=jnp.asarray(prior))
    )
    return disparity.ravel()[np.asarray(shown)]


def _steps(ends, shape=(16, 24)):
    return np.tile(np.where(np.arange(shape[1]) < ends, 1.0, 0.0), (shape[0], 1))


@pytest.mark.parametrize(("front", "back"), [(0.6, 0.02), (0.02, 0.6), (0.3, 0.05)])
@pytest.mark.parametrize("share", [0.3, 0.4, 0.6, 0.7])
@pytest.mark.parametrize("drawn", [12, 13])
def test_a_pixel_belongs_to_what_covers_most_of_it_in_linear_light(front, back, share, drawn):
    # The front ends within column 12, of which it covers a share.
    light = np.full((16, 24), back)
    light[:, :12], light[:, 12] = front, share * front + (1 - share) * back
    expected = _steps(13 if share > 0.5 else 12)
    np.testing.assert_array_equal(_outlined(_steps(drawn), light), expected)


def test_what_has_no_outline_stays_and_a_pixel_between_two_surfaces_is_given_to_one():
    disparity = _steps(13)
    np.testing.assert_array_equal(_outlined(disparity, np.full((16, 24), 0.2)), disparity)
    steep = np.tile(0.3 * np.arange(24.0), (16, 1))
    light = np.random.default_rng(0).random((16, 24))
    np.testing.assert_array_equal(_outlined(steep, light, prior=0.0), steep)
    between = _steps(12)
    between[:, 12] = 0.5
    light = np.where(np.arange(24) < 12, 0.6, 0.1)
    light[12] = 0.2
    np.testing.assert_array_equal(_outlined(between, light), _steps(12))


def test_the_more_the_map_is_believed_the_less_it_changes():
    rng = np.random.default_rng(1)
    light = np.clip(np.where(np.arange(40) < 20, 0.5, 0.3) + 0.1 * rng.normal(size=(40, 40)), 0, 1)
    disparity = _steps(20, (40, 40))
    changed = [(_outlined(disparity, light, prior=p) != disparity).sum() for p in (0.0, 2.0, 50.0)]
    assert changed[0] > changed[1] > changed[2] == 0


def test_noise_takes_the_colours_word_away():
    light = np.where(np.arange(24) < 12, 0.32, 0.3)
    light[12] = 0.316
    disparity = _steps(12)
    assert (_outlined(disparity, light) != disparity).any()
    np.testing.assert_array_equal(_outlined(disparity, light, noise=0.1), disparity)


def test_the_share_is_a_weighted_ridge_regression():
    rng, params = np.random.default_rng(2), Outline()
    reach, width, faint = params.reach, float(params.width), float(params.faint)
    disparity = _steps(7, (12, 14)) + 0.01 * rng.random((12, 14))
    light, sure = (
        rng.random((3, 12, 14)),
        np.where(rng.random((12, 14)) > 0.8, float(params.doubt), 1.0),
    )
    middle = np.full((12, 14), 0.5)
    images = np.pad(np.stack([disparity, middle, sure, *light]), ((0, 0), *[(reach, reach)] * 2))
    share, unexplained = _share(jnp.asarray(images)[None], params=params, faint=params.faint)[0]
    for y, x in ((0, 0), (5, 6), (11, 9)):
        # The border repeats values and has no weight.
        around = [
            (v, u)
            for v in range(max(y - reach, 0), min(y + reach + 1, 12))
            for u in range(max(x - reach, 0), min(x + reach + 1, 14))
            if (v - y) ** 2 + (u - x) ** 2 <= reach**2 + 1
        ]
        v, u = np.array(around).T
        weight = sure[v, u] * np.exp(-0.5 * ((v - y) ** 2 + (u - x) ** 2) / width**2)
        weight /= weight.sum()
        front, colours = (disparity[v, u] > 0.5) * 1.0, light[:, v, u].T
        mean, ahead = weight @ colours, weight @ front
        centred = colours - mean
        covariance = centred.T @ (weight[:, None] * centred) + faint * np.eye(3)
        along = centred.T @ (weight * (front - ahead))
        slope = np.linalg.solve(covariance, along)
        np.testing.assert_allclose(share[y, x], ahead + slope @ (light[:, y, x] - mean), rtol=1e-9)
        left = ahead * (1 - ahead) - along @ slope
        np.testing.assert_allclose(unexplained[y, x], left, rtol=1e-9, atol=1e-12)


def test_single_precision_tells_the_same():
    rng = np.random.default_rng(3)
    texture = 1 + 0.1 * rng.random((32, 32))
    # Colours on a line, as beside an edge without texture of its own: the covariance is singular.
    light = (
        np.where(np.arange(32) < 16, 0.5, 0.2) * texture * np.array([1, 0.8, 0.6])[:, None, None]
    )
    disparity = _steps(17, (32, 32))
    view = _encoded(light)
    even = Outline(odds=jnp.asarray(1.0))
    double = outline(jnp.asarray(disparity), jnp.asarray(view), jnp.asarray(0.001), even)
    lower = (jnp.asarray(a, jnp.float32) for a in (disparity, view, 0.001))
    single = outline(*lower, params=even)
    np.testing.assert_array_equal(single, double)
    assert (disparity.ravel()[np.asarray(double)] != disparity).sum() > 16


def test_it_is_a_selection_without_gradient():
    light = np.broadcast_to(np.where(np.arange(24) < 12, 0.6, 0.1), (3, 16, 24))
    view, even = jnp.asarray(_encoded(light)), Outline(odds=jnp.asarray(1.0))

    def total(disparity):
        return jnp.sum(disparity.ravel()[outline(disparity, view, jnp.asarray(0.0), even)])

    slope = jax.grad(total)(jnp.asarray(_steps(13)))
    assert slope.sum() == 16 * 24
    assert (slope[:, 12] == 0).all()
