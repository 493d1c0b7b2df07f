"""Points onto pixels: the nearest label wins, or labels are shared by nearby pixels."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._params import accepts_numpy
from mvedge_jax._root import LEAST_DIVISOR
from mvedge_jax.image import nearest_pixels


class Raster(NamedTuple):
    """Which point each pixel shows.

    Attributes:
        slot: slot of the point, `[y, x]`; the number of points where there is none.
        hit: whether a pixel shows a point, `[y, x]`.
    """

    slot: Int[Array, "y x"]
    hit: Bool[Array, "y x"]

    def values(self, values: Float[Array, " n"]) -> Float[Array, "y x"]:
        """One value per point as an image, 0 where there is no point. Differentiable."""
        padded = jnp.concatenate([values, jnp.zeros_like(values[:1])])
        return padded[self.slot]


@accepts_numpy
def rasterize(
    xy: Float[Array, "n 2"],
    disparity: Float[Array, " n"],
    valid: Bool[Array, " n"],
    shape: tuple[int, int],
) -> Raster:
    """Puts points on their nearest pixels; of several on one pixel, the nearest surface wins.

    Bilinear splatting would mix the labels of both sides of an edge.

    Args:
        xy: positions `(x, y)`, px; points outside of the image are left out.
        disparity: the largest one wins; ties go to the later point.
        valid: which slots hold a point.
        shape: rows and columns of the image.

    Returns:
        The selection. It has no gradient; values gathered with it have one.
    """
    disparity = lax.stop_gradient(disparity)
    height, width = shape
    at = nearest_pixels(xy, shape)
    inside = valid & at.inside
    count = disparity.shape[0]
    place = jnp.where(inside, at.places(width), height * width)
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


@accepts_numpy
def share(
    xy: Float[Array, "n 2"],
    disparity: Float[Array, " n"],
    weight: Float[Array, " n"],
    surface: Float[Array, "y x"],
    tolerance: Float[Array, ""],
) -> tuple[Float[Array, "y x"], Float[Array, "y x"]]:
    """Shares every label bilinearly among the four pixels around it that lie on its surface.

    Plain bilinear splatting would mix the labels of both sides of an edge. Here the share of a
    pixel also falls with the distance of the label from a map of the surfaces.

    Args:
        xy: positions `(x, y)`, px; shares outside of the image are lost.
        disparity: of the labels, px per view step.
        weight: of the labels, 0 for empty slots.
        surface: a map of the surfaces, px per view step, `[y, x]`.
        tolerance: distance from the map, px, at which a share is a quarter.

    Returns:
        Sum of weights and weighted mean of labels per pixel, `[y, x]`; the mean is the map where
        there is no label, and a sum below 1e-9 is none. Differentiable in all arguments, positions
        included.
    """
    height, width = surface.shape
    whole = jnp.floor(lax.stop_gradient(xy))
    part = xy - whole
    first = whole.astype(jnp.int32)
    places, shares = [], []
    for down in (0, 1):
        for right in (0, 1):
            x, y = first[:, 0] + right, first[:, 1] + down
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (weight > 0)
            place = jnp.where(inside, y * width + x, 0)
            there = surface.reshape(-1)[place]
            across = part[:, 0] if right else 1 - part[:, 0]
            along = part[:, 1] if down else 1 - part[:, 1]
            agreed = 1 / (1 + ((disparity - there) / tolerance) ** 2) ** 2
            places.append(place)
            shares.append(jnp.where(inside, weight * across * along * agreed, 0))
    place, amount = jnp.concatenate(places), jnp.concatenate(shares)
    # Relative to the map, so that rounding does not grow with the disparity.
    change = amount * (jnp.tile(disparity, 4) - surface.reshape(-1)[place])
    both = jnp.zeros((height * width, 2), amount.dtype)
    total, moved = both.at[place].add(jnp.stack([amount, change], axis=1)).T
    # The derivative of a mean over smaller weights is not a number in single precision.
    there = total > LEAST_DIVISOR
    total, mean = (
        jnp.where(there, total, 0),
        jnp.where(there, moved, 0) / jnp.where(there, total, 1),
    )
    return total.reshape(height, width), surface + mean.reshape(height, width)
