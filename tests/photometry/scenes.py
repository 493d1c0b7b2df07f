"""Light fields whose noise and gains are known."""

import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry.brightness import Brightness, GridViews


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
    """Gains of the crosshair's views, relative to the centre view; 1 elsewhere."""
    rng = np.random.default_rng(seed)
    gain = np.ones((views, views))
    middle = views // 2
    gain[middle] = 1 + rng.uniform(-spread, spread, views)
    gain[:, middle] = 1 + rng.uniform(-spread, spread, views)
    gain[middle, middle] = 1
    return gain


def rough_exposure(light_field, *, params=None):
    """What is measured without a map."""
    return GridViews(light_field).rough_exposure(Brightness() if params is None else params)


def exposure_along(light_field, scale, disparity, *, every=False):
    """What is measured along a map."""
    return GridViews(light_field, every=every).exposure_along(scale, disparity, Brightness())
