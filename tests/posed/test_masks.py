"""Transparent pixels of photographs: they take no part, and get no depth."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from posed.walls import MATRIX, POSES, wall

from mvedge_jax.photometry import Noise
from mvedge_jax.photometry._scene import adapted_measurement
from mvedge_jax.photometry.measuring import Measurement, ViewSplines
from mvedge_jax.photometry.views import ViewSet
from mvedge_jax.photometry.views._parallax import shown_at
from mvedge_jax.posed import (
    Photographs,
    StereoDepth,
    posed_sweep,
    projections,
    reference_of,
    stereo,
)

IMAGES, DEPTHS = wall(POSES)
Y, X = np.mgrid[:36, :48]
MASK = np.stack([np.hypot(X - 24, Y - 18) < 15] * 4)
RANGE = (1.2, 3.5)


def cut(color: float) -> Photographs:
    """The wall, of which a disc is left, on a color."""
    images = np.where(MASK[..., None], IMAGES, color)
    return Photographs(jnp.asarray(images), POSES, MATRIX, mask=MASK)


def test_positions_are_shown_where_their_nearest_pixel_is():
    shown = jnp.zeros((3, 4)).at[1, 2].set(1)
    x, y = jnp.asarray([[1.6, 2.4, 1.4, 9.0]]), jnp.asarray([[0.6, 1.4, 1.0, -3.0]])
    assert shown_at(shown, x, y).tolist() == [[True, True, False, False]]


def test_what_is_transparent_is_read_in_no_photograph():
    """Of an opaque pixel, nothing changes with the color of what is transparent elsewhere."""
    shown = jnp.asarray(MASK, jnp.float64)
    reference = reference_of(cut(0.0), 0, depth_range=RANGE)
    scale = reference.scale(cut(0.0))
    parallax = projections(jnp.asarray(POSES), cut(0.0).intrinsics, 0, scale)
    disparity = scale / jnp.asarray(DEPTHS[0])
    params = adapted_measurement(Noise.of(jnp.asarray(0.002)), jnp.asarray(1.0), Measurement())
    # Splines reach far, though hardly: what is next to the mask is left out of it here.
    inner = jax.vmap(lambda m: jnp.asarray(np.hypot(X - 24, Y - 18) < 5) & (m > 0))(shown)
    both = []
    for color in (0.0, 0.7):
        images = jnp.moveaxis(jnp.asarray(cut(color).images), -1, 1)
        views = ViewSet(images, parallax, jnp.ones(4, bool), inner.astype(jnp.float64))
        both.append(ViewSplines.of(views).accumulate(disparity, params))
    for name in ("right", "information", "power", "freedom"):
        one, other = (np.asarray(getattr(each, name)) for each in both)
        assert np.isfinite(one).all()
        np.testing.assert_allclose(one[inner[0]], other[inner[0]], atol=1e-3, rtol=0.02)
        # What is transparent is seen by the reference alone, and tells nothing.
        if name == "freedom":
            assert one[~inner[0]].max() < 1e-9
            continue
        np.testing.assert_allclose(one[~inner[0]], 0, atol=1e-9)


def test_a_sweep_has_no_depth_where_the_photograph_is_transparent():
    wanted = reference_of(cut(0.0), 0, depth_range=RANGE)
    found = np.asarray(posed_sweep(cut(0.0), wanted, StereoDepth.of(wanted)).depth)
    assert np.isnan(found[~MASK[0]]).all()
    assert np.isfinite(found[MASK[0]]).all()
    inner = np.hypot(X - 24, Y - 18) < 9
    # As far off as without a mask, .039.
    assert np.median(np.abs(found / DEPTHS[0] - 1)[inner]) < 0.045


@pytest.mark.slow
def test_the_object_keeps_its_depth_and_the_rest_has_none():
    wanted = reference_of(cut(0.0), 0, depth_range=RANGE)
    run = jax.jit(lambda p: stereo(p, wanted, StereoDepth.of(wanted)))
    found = run(cut(0.0))
    depth, error = np.asarray(found.depth), np.asarray(found.error)
    assert np.isnan(depth[~MASK[0]]).all()
    assert np.isinf(error[~MASK[0]]).all()
    assert np.isfinite(depth[MASK[0]]).all()
    assert np.isfinite(error[MASK[0]]).all()
    assert np.median(np.abs(depth / DEPTHS[0] - 1)[MASK[0]]) < 0.01
    assert not any("NaN" in text for text in found.problems())
    # The color of what is transparent has next to no say.
    other = np.asarray(run(cut(0.5)).depth)
    inner = np.hypot(X - 24, Y - 18) < 11
    assert np.median(np.abs(other / DEPTHS[0] - 1)[inner]) < 0.01
