"""Which of two surfaces a pixel beside a step shows."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mvedge_jax.warping import Outline, holes, outline
from mvedge_jax.warping._blocks import in_blocks
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
@pytest.mark.parametrize("share", [0.4, 0.6])
@pytest.mark.parametrize("drawn", [12, 13])
def test_a_pixel_belongs_to_what_covers_most_of_it_in_linear_light(front, back, share, drawn):
    # The front ends within column 12, of which it covers a share.
    light = np.full((16, 24), back)
    light[:, :12], light[:, 12] = front, share * front + (1 - share) * back
    expected = _steps(13 if share > 0.5 else 12)
    assert_array_equal(_outlined(_steps(drawn), light), expected)


def test_what_has_no_outline_stays_and_a_pixel_between_two_surfaces_is_given_to_one():
    disparity = _steps(13)
    assert_array_equal(_outlined(disparity, np.full((16, 24), 0.2)), disparity)
    steep = np.tile(0.3 * np.arange(24.0), (16, 1))
    light = np.random.default_rng(0).random((16, 24))
    assert_array_equal(_outlined(steep, light, prior=0.0), steep)
    between = _steps(12)
    between[:, 12] = 0.5
    light = np.where(np.arange(24) < 12, 0.6, 0.1)
    light[12] = 0.2
    assert_array_equal(_outlined(between, light), _steps(12))


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
        front, colors = (disparity[v, u] > 0.5) * 1.0, light[:, v, u].T
        mean, ahead = weight @ colors, weight @ front
        centerd = colors - mean
        covariance = centerd.T @ (weight[:, None] * centerd) + faint * np.eye(3)
        along = centerd.T @ (weight * (front - ahead))
        slope = np.linalg.solve(covariance, along)
        assert_allclose(share[y, x], ahead + slope @ (light[:, y, x] - mean), rtol=1e-9)
        left = ahead * (1 - ahead) - along @ slope
        assert_allclose(unexplained[y, x], left, rtol=1e-9, atol=1e-12)


def test_it_is_a_selection_without_gradient():
    light = np.broadcast_to(np.where(np.arange(24) < 12, 0.6, 0.1), (3, 16, 24))
    view, even = jnp.asarray(_encoded(light)), Outline(odds=jnp.asarray(1.0))

    def total(disparity):
        return jnp.sum(disparity.ravel()[outline(disparity, view, jnp.asarray(0.0), even)])

    slope = jax.grad(total)(jnp.asarray(_steps(13)))
    assert slope.sum() == 16 * 24
    assert (slope[:, 12] == 0).all()


_TOLERANCE = 0.3


def _around(disparity, hit, y, x):
    """The nearest pixels that were hit: to the left, to the right, above, below; or None."""
    found = []
    for dy, dx in ((0, -1), (0, 1), (-1, 0), (1, 0)):
        v, u = y + dy, x + dx
        while 0 <= v < hit.shape[0] and 0 <= u < hit.shape[1] and not hit[v, u]:
            v, u = v + dy, u + dx
        inside = 0 <= v < hit.shape[0] and 0 <= u < hit.shape[1]
        found.append((v, u, disparity[v, u], abs(v - y) + abs(u - x)) if inside else None)
    return found


def _row(hit, y, step):
    """The nearest row above or below with a pixel that was hit, or None."""
    y += step
    while 0 <= y < hit.shape[0]:
        if hit[y].any():
            return y
        y += step
    return None


@pytest.mark.parametrize("shape", [(9, 1), (7, 12)])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 1.0])
def test_holes_are_those_of_a_walk_from_each_pixel(shape, share):
    rng = np.random.default_rng(0)
    # What is not hit must not be read.
    hit = rng.random(shape) < share
    disparity = np.where(hit, rng.normal(size=shape), np.nan)
    found = holes(jnp.asarray(disparity), jnp.asarray(hit), tolerance=_TOLERANCE)
    for y, x in np.ndindex(shape):
        behind, spread, crack = (np.asarray(a)[y, x] for a in found)
        own = y * shape[1] + x
        if hit[y, x]:
            assert (behind, spread, crack) == (own, 0, False)
            continue
        around = _around(disparity, hit, y, x)
        known = [place for place in around if place is not None]
        if not known:
            beside = [r for r in (_row(hit, y, -1), _row(hit, y, 1)) if r is not None]
            expected = (0, 0, False)
            if beside:
                sources = [(np.asarray(found.behind)[r, x], r) for r in beside]
                source, row = min(sources, key=lambda s: disparity.ravel()[s[0]])
                expected = (source, np.asarray(found.spread)[row, x], False)
            assert (behind, spread, crack) == expected
            continue
        v, u, farthest, _ = min(known, key=lambda place: place[2])
        values = [place[2] for place in known]
        assert behind == v * shape[1] + u
        assert disparity[v, u] == farthest
        assert spread == pytest.approx(max(values) - min(values))
        pairs = [(around[0], around[1]), (around[2], around[3])]
        expected = any(
            a is not None and b is not None and a[3] == b[3] == 1 and abs(a[2] - b[2]) <= _TOLERANCE
            for a, b in pairs
        )
        assert crack == expected


_REACH = 2


def _box_and_product(pieces):
    """Sums over 5x5 pixels of the first image, and the product of both images."""
    height, width = (size - 2 * _REACH for size in pieces.shape[-2:])
    span = range(2 * _REACH + 1)
    box = sum(pieces[:, 0, y : y + height, x : x + width] for y in span for x in span)
    inner = pieces[:, :, _REACH : _REACH + height, _REACH : _REACH + width]
    return jnp.stack([box, inner[:, 0] * inner[:, 1]], axis=1)


def _whole(images):
    margin = ((0, 0), (_REACH, _REACH), (_REACH, _REACH))
    return _box_and_product(np.pad(images, margin)[None])[0]


@pytest.mark.parametrize("shape", [(3, 40), (100, 130)])
@pytest.mark.parametrize("share", [0.0, 0.002, 1.0])
def test_what_is_wanted_is_that_of_the_whole_image(shape, share):
    rng = np.random.default_rng(0)
    images, wanted = rng.normal(size=(2, *shape)), rng.random(shape) < share
    found = np.asarray(
        in_blocks(_box_and_product, jnp.asarray(wanted), jnp.asarray(images), reach=_REACH)
    )
    expected = np.asarray(_whole(images))
    assert found.shape == expected.shape
    assert_allclose(found[:, wanted], expected[:, wanted], rtol=1e-12, atol=1e-12)
