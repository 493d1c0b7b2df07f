"""Light fields of one plane, whose disparity is known."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from mvedge_jax._crosshair import crosshair
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry.measuring import CrosshairSplines, labels


def plane_views(disparity, *, views=(5, 5), size=(20, 28), noise=0.0, seed=0):
    """A fronto-parallel plane with a smooth random texture, sampled from a spline."""
    rng = np.random.default_rng(seed)
    pad = 10
    texture = rng.uniform(size=(size[0] + 2 * pad, size[1] + 2 * pad, 3))
    texture = ndimage.gaussian_filter(texture, (1.2, 1.2, 0)) * 2 - 0.5
    y, x = np.mgrid[0 : size[0], 0 : size[1]].astype(float) + pad
    grid = np.zeros((*views, *size, 3))
    for v, u in np.ndindex(*views):
        place = [y - (views[0] // 2 - v) * disparity, x - (views[1] // 2 - u) * disparity]
        for c in range(3):
            grid[v, u, ..., c] = ndimage.map_coordinates(texture[..., c], place, order=3)
    grid += noise * rng.standard_normal(grid.shape)
    return LightField(jnp.asarray(np.clip(grid, 0, 1)))


def plane_arms(disparity, **choices):
    """The arms of `plane_views`."""
    return crosshair(plane_views(disparity, **choices))


def plane_splines(disparity, **choices):
    """The arms of `plane_views`, ready for being looked at."""
    return CrosshairSplines.of(plane_arms(disparity, **choices))


def accumulate(across, down, disparity, params, *, radius):
    """What two arms show around a map."""
    return CrosshairSplines(across, down).accumulate(disparity, replace(params, radius=radius))


def photometric_labels(across, down, lab, disparity, params, *, radius, passes):
    """Labels measured in two arms."""
    found = accumulate(across, down, disparity, params, radius=radius)
    return labels(found, lab, disparity, params, passes=passes)
