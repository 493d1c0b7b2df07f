"""A card before a wall, as views that are exact copies."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from mvedge_jax.lightfield import GroundTruth, LightField

NEAR, FAR = 1.0, -1.0


def _texture(shape, rng):
    """Smooth random colors, so that they can be told apart and followed."""
    coarse = rng.random((shape[0] // 3 + 2, shape[1] // 3 + 2, 3))
    y, x = (np.arange(n) / 3 for n in shape)
    fine = np.stack([_bilinear(coarse[..., c], y, x) for c in range(3)], -1)
    return fine


def _bilinear(image, y, x):
    b, a = y.astype(int), x.astype(int)
    t, s = (y - b)[:, None], (x - a)[None]
    rows = (1 - t) * image[b] + t * image[b + 1]
    return (1 - s) * rows[:, a] + s * rows[:, a + 1]


def cards(shape=(5, 5, 40, 48), dtype: Any = np.float32) -> Any:
    """A dark card before a bright wall, at whole disparities: views are exact copies."""
    rows, columns, height, width = shape
    rng = np.random.default_rng(0)
    margin = max(rows, columns)
    wall = 0.5 + 0.4 * _texture((height + 2 * margin, width + 2 * margin), rng)
    card = 0.3 * _texture((height + 2 * margin, width + 2 * margin), rng)
    y, x = np.mgrid[:height, :width]
    views, truth = np.zeros((*shape, 3)), np.zeros(shape)
    for v, u in np.ndindex(rows, columns):
        a, b = columns // 2 - u, rows // 2 - v

        def at(image, d, a=a, b=b):
            """What a plane shows: the pixel of the center view that a pixel of this view is."""
            return image[margin + y - b * int(d), margin + x - a * int(d)]

        row, column = y - b * NEAR, x - a * NEAR
        on = (abs(row - height // 2) < height // 4) & (abs(column - width // 2) < width // 4)
        views[v, u] = np.where(on[..., None], at(card, NEAR), at(wall, FAR))
        truth[v, u] = np.where(on, NEAR, FAR)
    center = truth[rows // 2, columns // 2]
    known = GroundTruth(
        jnp.asarray(center, dtype), jnp.ones((height, width), bool), None, jnp.asarray(truth, dtype)
    )
    return LightField(jnp.asarray(views, dtype), disparity_range=(-1.5, 1.5), truth=known)
