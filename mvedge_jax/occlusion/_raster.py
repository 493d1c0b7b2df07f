"""Points onto pixels: the nearest label wins."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int


class Raster(NamedTuple):
    """Which point each pixel shows.

    Attributes:
        slot: of the point, `[y, x]`; the number of points where there is none.
        hit: pixels that show a point, `[y, x]`.
    """

    slot: Int[Array, "y x"]
    hit: Bool[Array, "y x"]

    def values(self, values: Float[Array, " n"]) -> Float[Array, "y x"]:
        """One value per point as an image, 0 where there is no point. Differentiable."""
        padded = jnp.concatenate([values, jnp.zeros_like(values[:1])])
        return padded[self.slot]


def rasterise(
    xy: Float[Array, "n 2"],
    disparity: Float[Array, " n"],
    valid: Bool[Array, " n"],
    shape: tuple[int, int],
) -> Raster:
    """Puts points on their nearest pixels; of several on one pixel, the nearest surface stays.

    Bilinear splatting would mix the two sides of an edge, which is what labels must not do.

    Args:
        xy: positions `(x, y)`, px; points outside of the image are left out.
        disparity: decides who stays; ties go to the later point.
        valid: which slots hold a point.
        shape: rows and columns of the image.

    Returns:
        The selection; no gradient passes through it, values gathered with it keep theirs.
    """
    xy, disparity = lax.stop_gradient((xy, disparity))
    height, width = shape
    column = jnp.round(xy[:, 0]).astype(jnp.int32)
    row = jnp.round(xy[:, 1]).astype(jnp.int32)
    inside = valid & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    count = disparity.shape[0]
    place = jnp.where(inside, row * width + column, height * width)
    lowest = jnp.full(height * width, -jnp.inf, disparity.dtype)
    nearest = lowest.at[place].max(disparity, mode="drop")
    seen = nearest[jnp.minimum(place, height * width - 1)]
    wins = inside & (disparity == seen)
    nobody = jnp.full(height * width, -1, jnp.int32)
    chosen = nobody.at[jnp.where(wins, place, height * width)].max(
        jnp.arange(count, dtype=jnp.int32), mode="drop"
    )
    hit = chosen >= 0
    return Raster(jnp.where(hit, chosen, count).reshape(shape), hit.reshape(shape))
