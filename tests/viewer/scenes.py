"""A light field whose every pixel is known: a square at disparity 1 before a plane at 0."""

import jax.numpy as jnp
import numpy as np

from mvedge_jax.lightfield import Camera, GroundTruth, LightField
from mvedge_jax.viewer import Result

SHAPE = (48, 64)
SQUARE = np.s_[16:32, 24:44]
# Of the square, and of what is behind it.
NEAR, FAR = (230, 60, 40), (40, 90, 200)


def disparity() -> np.ndarray:
    values = np.zeros(SHAPE)
    values[SQUARE] = 1
    return values


def square_field(*, grid=(5, 5), known=True, missing=()) -> LightField:
    views = np.empty((*grid, *SHAPE, 3))
    available = np.ones(grid, bool)
    for v, u in np.ndindex(*grid):
        near = np.roll(disparity(), (grid[0] // 2 - v, grid[1] // 2 - u), (0, 1)) > 0.5
        views[v, u] = np.where(near[..., None], NEAR, FAR) / np.array(255.0)
    for view in missing:
        available[view] = False
        views[view] = 0
    truth = GroundTruth(jnp.asarray(disparity()), jnp.ones(SHAPE, bool)) if known else None
    camera = Camera(100.0, 0.1, 5.0) if known else None
    return LightField(views, available=available, truth=truth, camera=camera, name="square")


def result(*, name="map", shift=0.0) -> Result:
    error = np.full(SHAPE, 0.02)
    error[:, :8] = 0.5
    error[0, 0] = np.inf
    xy = np.array([[24.0, 20.0], [24.0, 24.0], [43.0, 20.0]])
    points = np.array([[1.0, 0.02], [1.0, 0.02], [0.9, 0.05]])
    across = np.array([[1.0, 0.0]] * 3)
    return Result(name, disparity() + shift, error, xy, points, across, 3 * across)
