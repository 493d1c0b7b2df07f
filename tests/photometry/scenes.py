"""Light fields whose disparity, noise and gains are known, and what is measured in them."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from mvedge_jax._crosshair import crosshair
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry.brightness import Brightness, GridViews
from mvedge_jax.photometry.measuring import (
    AdaptedMeasurement,
    CrosshairSplines,
    ViewSplines,
    labels,
)
from mvedge_jax.photometry.views import views_of


def textured(
    *, views=5, size=(96, 112), disparity=0.5, seed=0, dtype: type = np.float32, low=0.15, blob=3.0
):
    """A plane whose texture is blobs of `blob` px, in views of `size`."""
    rng = np.random.default_rng(seed)
    height, width = size
    margin = 8
    shape = (height + 2 * margin, width + 2 * margin, 3)
    texture = ndimage.gaussian_filter(rng.normal(size=shape), (blob, blob, 0))
    texture = low + 0.6 * (texture - texture.min()) / np.ptp(texture)
    images = np.zeros((views, views, height, width, 3))
    for v, u in np.ndindex(views, views):
        shift = ((v - views // 2) * disparity, (u - views // 2) * disparity, 0)
        moved = ndimage.shift(texture, [-s for s in shift], order=3, mode="nearest")
        images[v, u] = moved[margin:-margin, margin:-margin]
    return LightField(jnp.asarray(np.clip(images, 0, 1).astype(dtype)), disparity_range=(-1, 1))


def changed(light_field, *, noise=0.0, gain=None, factor=1.0, bits=True, seed=1):
    """The same views with noise, gains and another brightness, clipped and rounded to 8 bit."""
    rng = np.random.default_rng(seed)
    views = np.asarray(light_field.views, np.float64) * factor
    if gain is not None:
        views = views * np.asarray(gain)[:, :, None, None, None]
    views = np.clip(views + rng.normal(0, noise, views.shape), 0, 1)
    if bits:
        views = np.round(255 * views) / 255
    return LightField(
        jnp.asarray(views, light_field.views.dtype), disparity_range=light_field.disparity_range
    )


def cross_gains(views=5, spread=0.08, seed=2):
    """Gains of the crosshair's views, relative to the center view; 1 elsewhere."""
    rng = np.random.default_rng(seed)
    gain = np.ones((views, views))
    middle = views // 2
    gain[middle] = 1 + rng.uniform(-spread, spread, views)
    gain[:, middle] = 1 + rng.uniform(-spread, spread, views)
    gain[middle, middle] = 1
    return gain


def of_crosshair(field):
    """The views of the crosshair alone, as a set of views in any places."""
    rows, columns = (np.arange(n) == n // 2 for n in field.views.shape[:2])
    views = views_of(field)
    cross = (rows[:, None] | columns[None]).reshape(-1)
    own = int(np.argmax((rows[:, None] & columns[None]).reshape(-1)))
    order = np.concatenate([[own], np.delete(np.arange(cross.size), own)])
    chosen = np.flatnonzero(cross[order])
    return jax.tree.map(lambda leaf: leaf[chosen], views)


def rough_exposure(light_field, *, params=None):
    """What is measured without a map."""
    return GridViews(light_field).rough_exposure(Brightness() if params is None else params)


def exposure_along(light_field, scale, disparity, *, every=False):
    """What is measured along a map."""
    return GridViews(light_field, every=every).exposure_along(scale, disparity, Brightness())


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
    """Labels around a map; of one color by default, so that no neighbor is left out for its."""
    params = params or AdaptedMeasurement()
    lab = jnp.zeros((3, *disparity.shape), disparity.dtype) if lab is None else lab
    found = look(views, disparity, params, radius=radius)
    return labels(found, lab, disparity, params, passes=passes)


def error(found, truth, inner=INNER):
    """Root of the mean squared error of a map, away from the border."""
    return float(jnp.sqrt(jnp.mean((found.disparity - truth)[inner] ** 2)))
