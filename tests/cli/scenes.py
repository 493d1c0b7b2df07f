"""A light field that several commands are tried on."""

import numpy as np
from scipy import ndimage


def textured_plane() -> np.ndarray:
    """A textured plane at disparity 0.4: 3x3 views of 32x40 px, in 8 bits."""
    rng = np.random.default_rng(0)
    texture = ndimage.gaussian_filter(rng.uniform(size=(52, 60, 3)), (0.9, 0.9, 0)) * 2 - 0.5
    y, x = np.mgrid[0:32, 0:40].astype(float) + 10
    views = np.zeros((3, 3, 32, 40, 3))
    for v, u in np.ndindex(3, 3):
        for c in range(3):
            place = [y - (1 - v) * 0.4, x - (1 - u) * 0.4]
            views[v, u, ..., c] = ndimage.map_coordinates(texture[..., c], place, order=3)
    return np.round(255 * np.clip(views, 0, 1)).astype(np.uint8)
