"""A light field that several commands are tried on."""

import numpy as np
from scipy import ndimage

# That of the files of `write_hci`, so that commands which take their range share a program with
# those that are told it.
RANGE = ("--range", "-1.5", "1.25")


def textured_plane(height: int = 32, width: int = 40) -> np.ndarray:
    """A textured plane at disparity 0.4: 3x3 views, in 8 bits."""
    rng = np.random.default_rng(0)
    grain = rng.uniform(size=(height + 20, width + 20, 3))
    texture = ndimage.gaussian_filter(grain, (0.9, 0.9, 0)) * 2 - 0.5
    y, x = np.mgrid[0:height, 0:width].astype(float) + 10
    views = np.zeros((3, 3, height, width, 3))
    for v, u in np.ndindex(3, 3):
        for c in range(3):
            place = [y - (1 - v) * 0.4, x - (1 - u) * 0.4]
            views[v, u, ..., c] = ndimage.map_coordinates(texture[..., c], place, order=3)
    return np.round(255 * np.clip(views, 0, 1)).astype(np.uint8)
