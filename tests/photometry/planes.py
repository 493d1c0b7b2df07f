"""Light fields of one plane, whose disparity is known."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from mvedge_jax._crosshair import crosshair
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry.measuring import (
    AdaptedMeasurement,
    CrosshairSplines,
    ViewSplines,
    labels,
)
from mvedge_jax.photometry.views import views_of

INNER = (slice(4, -4), slice(4, -4))


def plane_views(disparity, *, views=(5, 5), size=(20, 28), noise=0.0, seed=0, span=None):
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
    return LightField(jnp.asarray(np.clip(grid, 0, 1)), disparity_range=span)


def plane_arms(disparity, **choices):
    """The arms of `plane_views`."""
    return crosshair(plane_views(disparity, **choices))


def splines_of(field, kind="crosshair") -> Any:
    """The views of the crosshair, or all, ready for being looked at."""
    if kind == "crosshair":
        return CrosshairSplines.of(crosshair(field))
    return ViewSplines.of(views_of(field))


def look(views, disparity, params=None, *, radius=2):
    """What views show around a map."""
    return views.accumulate(disparity, replace(params or AdaptedMeasurement(), radius=radius))


def measured(views, disparity, params=None, *, lab=None, radius=2, passes=2):
    """Labels around a map; of one colour by default, so that no neighbour is left out for its."""
    params = params or AdaptedMeasurement()
    lab = jnp.zeros((3, *disparity.shape), disparity.dtype) if lab is None else lab
    found = look(views, disparity, params, radius=radius)
    return labels(found, lab, disparity, params, passes=passes)


def error(found, truth, inner=INNER):
    """Root of the mean squared error of a map, away from the border."""
    return float(jnp.sqrt(jnp.mean((found.disparity - truth)[inner] ** 2)))
