"""Reprojection error: against SciPy, a loop over pixels for visibility, and scikit-image's Lab."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient
from scipy import ndimage
from skimage import color

from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import reprojection_error


def _scene(shape=(3, 5, 9, 12)):
    rng = np.random.default_rng(4)
    views = ndimage.gaussian_filter(rng.random((*shape, 3)), (0, 0, 1, 1, 0))
    disparity = rng.integers(-1, 3, shape[2:]) + 0.1 * rng.normal(size=shape[2:])
    return jnp.asarray(disparity), LightField(jnp.asarray(views))


def _visible(disparity, step, tolerance):
    height, width = disparity.shape
    landed = {}
    for y, x in np.ndindex(height, width):
        d = disparity[y, x]
        place = (int(np.round(y + step[1] * d)), int(np.round(x + step[0] * d)))
        landed.setdefault(place, []).append((y, x))
    seen = np.zeros(disparity.shape, bool)
    for (b, a), sources in landed.items():
        front = max(disparity[s] for s in sources)
        for s in sources:
            behind = (front - disparity[s]) * np.abs(step).max()
            seen[s] = 0 <= b < height and 0 <= a < width and behind <= tolerance
    return seen


@pytest.mark.parametrize("space", ["rgb", "lab"])
@pytest.mark.parametrize("crop", [0, 2])
def test_agrees_with_scipy(space, crop):
    disparity, scene = _scene()
    result = reprojection_error(disparity, scene, space=space, crop=crop)
    views = np.asarray(scene.views)
    views = color.rgb2lab(views) if space == "lab" else views
    y, x = np.mgrid[:9, :12].astype(float)
    inner = np.s_[crop : 9 - crop, crop : 12 - crop]
    errors, covered = [], []
    for v, u in ((0, 0), (0, 4), (2, 0), (2, 4)):
        step = np.array([2 - u, 1 - v])
        at = [y + step[1] * np.asarray(disparity), x + step[0] * np.asarray(disparity)]
        warped = np.stack(
            [ndimage.map_coordinates(views[v, u, ..., c], at, order=1) for c in range(3)], -1
        )
        difference = warped - views[1, 2]
        error = (
            100 * np.abs(difference).mean(-1)
            if space == "rgb"
            else np.linalg.norm(difference, axis=-1)
        )
        inside = (at[0] >= 0) & (at[0] <= 8) & (at[1] >= 0) & (at[1] <= 11)
        seen = (inside & _visible(np.asarray(disparity), step, 1.0))[inner]
        errors.append(error[inner][seen].mean())
        covered.append(seen.mean())
    np.testing.assert_allclose(result.per_view, errors, rtol=2e-4 if space == "lab" else 1e-10)
    np.testing.assert_allclose(result.covered, covered)
    np.testing.assert_allclose(result.error, result.per_view.mean())
    assert result.image.shape == (9 - 2 * crop, 12 - 2 * crop)


def test_gradients_match_differences():
    disparity, scene = _scene((3, 3, 6, 7))

    def loss(tree):
        d, views = tree
        return reprojection_error(d, LightField(views, available=scene.available)).error

    check_gradient(
        loss, (0.3 * disparity, scene.views), rtol=1e-5, step=1e-7, key=jax.random.key(1)
    )


def test_the_right_disparity_has_the_smallest_error():
    x = np.arange(40.0)
    image = 0.5 + 0.4 * np.sin(x / 3)[:, None] * np.array([1.0, 0.5, -0.7])
    shifted = [
        np.stack([np.interp(x + 0.75 * du, x, image[:, c]) for c in range(3)], -1)
        for du in (-1, 0, 1)
    ]
    views = np.broadcast_to(np.stack(shifted)[None, :, None], (3, 3, 6, 40, 3))
    scene = LightField(jnp.asarray(views))
    errors = [
        reprojection_error(jnp.full((6, 40), d), scene, targets=((1, 0), (1, 2))).error
        for d in (-0.75, 0.0, 0.75)
    ]
    assert errors[2] < 0.5
    assert min(errors[:2]) > 5 * errors[2]
