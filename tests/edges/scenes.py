"""Small light fields with closed-form disparity, for tests of points and filters."""

import jax.numpy as jnp
import numpy as np

from mvedge_jax.lightfield import LightField


def waves(x, y, seed):
    """A smooth, colorful texture that is known between pixels: sums of sines."""
    rng = np.random.default_rng(seed)
    value = np.zeros((*np.broadcast_shapes(x.shape, y.shape), 3))
    for _ in range(10):
        angle, length = rng.uniform(0, np.pi), rng.uniform(4.5, 11)
        phase, color = rng.uniform(0, 2 * np.pi), rng.uniform(0.2, 1, 3)
        wave = np.sin(2 * np.pi * (np.cos(angle) * x + np.sin(angle) * y) / length + phase)
        value += wave[..., None] * color
    return 0.5 + 0.05 * value


def plane(disparity, *, views=5, rows=None, size=(24, 32), seed=0, dtype=jnp.float32, span=None):
    """A fronto-parallel textured plane: exact at any disparity."""
    rows = views if rows is None else rows
    height, width = size
    y, x = np.mgrid[0:height, 0:width].astype(float)
    image = np.zeros((rows, views, height, width, 3))
    for v, u in np.ndindex(rows, views):
        image[v, u] = waves(x - (views // 2 - u) * disparity, y - (rows // 2 - v) * disparity, seed)
    span = (disparity - 0.35, disparity + 0.35) if span is None else span
    return LightField(jnp.asarray(np.clip(image, 0, 1), dtype), disparity_range=span)


def flat_rectangle(disparity, *, views=9, size=(64, 96)):
    """A rectangle of one color before a wall of another: nothing but its border to measure."""
    y, x = np.mgrid[0 : size[0], 0 : size[1]].astype(float)
    image = np.zeros((views, views, *size, 3))
    for v, u in np.ndindex(views, views):
        own_y, own_x = y - (views // 2 - v) * disparity, x - (views // 2 - u) * disparity
        cover = np.clip(own_x - 19.5, 0, 1) * np.clip(size[1] - 19.5 - own_x, 0, 1)
        cover = cover * np.clip(own_y - 11.5, 0, 1) * np.clip(size[0] - 11.5 - own_y, 0, 1)
        image[v, u] = (0.6 - 0.3 * cover)[..., None] * np.array([1.0, 0.9, 0.8])
    return LightField(jnp.asarray(image, jnp.float32))


def two_planes(near, far, *, edge, views=9, size=(16, 64), dtype=jnp.float32):
    """A vertical occluding edge: a near textured plane left of `edge`, a far one right of it."""
    height, width = size
    y, x = np.mgrid[0:height, 0:width].astype(float)
    image = np.zeros((views, views, height, width, 3))
    for v, u in np.ndindex(views, views):
        du, dv = views // 2 - u, views // 2 - v
        front = waves(x - du * near, y - dv * near, 1)
        back = 0.6 * waves(x - du * far, y - dv * far, 2)
        cover = np.clip(edge + du * near - x + 0.5, 0, 1)[..., None]
        image[v, u] = cover * front + (1 - cover) * back
    span = (min(near, far) - 0.3, max(near, far) + 0.3)
    return LightField(jnp.asarray(np.clip(image, 0, 1), dtype), disparity_range=span)


def fence(near, far, *, slats, views=9, size=(16, 64), dtype=jnp.float32):
    """Near vertical slats `(left, right)` before a far plane, both textured.

    Returns the light field, and which surface and which disparity every pixel of the middle row of
    views shows [u y x].
    """
    height, width = size
    y, x = np.mgrid[0:height, 0:width].astype(float)
    image = np.zeros((views, views, height, width, 3))
    surfaces = np.zeros((views, height, width), int)
    for v, u in np.ndindex(views, views):
        du, dv = views // 2 - u, views // 2 - v
        front = 0.3 + 0.7 * waves(x - du * near, y - dv * near, 1)
        back = 0.6 * waves(x - du * far, y - dv * far, 2)
        own = x - du * near
        cover = np.zeros_like(own)
        for left, right in slats:
            cover += np.clip(own - left + 0.5, 0, 1) - np.clip(own - right + 0.5, 0, 1)
        image[v, u] = cover[..., None] * front + (1 - cover[..., None]) * back
        if v == views // 2:
            surfaces[u] = cover > 0.5
    span = (min(near, far) - 0.3, max(near, far) + 0.3)
    light_field = LightField(jnp.asarray(np.clip(image, 0, 1), dtype), disparity_range=span)
    return light_field, surfaces, np.where(surfaces, near, far)
