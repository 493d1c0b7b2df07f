"""Forward reprojection: move pixels into another view, the nearest one wins."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._params import accepts_numpy


class ForwardWarp(NamedTuple):
    """A reprojected image.

    Attributes:
        image: values of the winning pixels; 0 in holes.
        disparity: disparity of the winning pixels; 0 in holes.
        hit: pixels on which any pixel landed.
    """

    image: Float[Array, "y x c"]
    disparity: Float[Array, "y x"]
    hit: Bool[Array, "y x"]


@accepts_numpy
def landing(
    disparity: Float[Array, "y x"], step: Float[Array, "2"]
) -> tuple[Int[Array, "y x"], Bool[Array, "y x"]]:
    """Flat index of the pixel of the other view that each pixel lands on.

    Halves are rounded upwards: a plane at half a pixel would become a comb otherwise.

    Args:
        disparity: px per view step; pixels that are not finite land nowhere.
        step: `(u_c - u, v_c - v)` of the other view.

    Returns:
        The index, one past the last pixel for pixels that leave the view, and whether they stay.
    """
    height, width = disparity.shape
    disparity = jax.lax.stop_gradient(disparity)
    finite = jnp.isfinite(disparity)
    shift = jnp.where(finite, disparity, 0)
    step = step.astype(disparity.dtype)
    x = jnp.arange(width, dtype=disparity.dtype)[None] + step[0] * shift
    y = jnp.arange(height, dtype=disparity.dtype)[:, None] + step[1] * shift
    x, y = jnp.floor(x + 0.5), jnp.floor(y + 0.5)
    stays = finite & (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    # As integers: float32 does not count the pixels of an image beyond 16 megapixels.
    index = jnp.where(stays, y.astype(jnp.int32) * width + x.astype(jnp.int32), height * width)
    return index, stays


@accepts_numpy
def z_buffer(order: Float[Array, "y x"], index: Int[Array, "y x"]) -> Float[Array, "_"]:
    """The nearest of all pixels that land on each pixel.

    Args:
        order: order of every pixel, larger is nearer.
        index: index of the pixel that each lands on, see `landing`.

    Returns:
        Flat, -inf in holes; the last entry collects pixels that leave the view.
    """
    buffer = jnp.full(order.size + 1, -jnp.inf, order.dtype)
    return buffer.at[index.ravel()].max(order.ravel(), mode="promise_in_bounds")


@accepts_numpy
def forward_warp(
    image: Float[Array, "y x c"], disparity: Float[Array, "y x"], step: Float[Array, "2"]
) -> ForwardWarp:
    """Moves every pixel of this view to its position in another view, nearest pixel in front.

    Positions are rounded to pixels; pixels that nothing lands on are holes. Among equal
    disparities the pixel with the smallest index wins.

    Args:
        image: values of this view.
        disparity: px per view step, larger is nearer.
        step: `(u_c - u, v_c - v)` from the center view to view `(v, u)`.

    Returns:
        The reprojected image. Differentiable with respect to `image` and, in its `disparity`
        part, to `disparity`; the places are piecewise constant.

    Source:
        Thesis 6.1.
    """
    shape = disparity.shape
    index, stays = landing(disparity, step)
    still = jax.lax.stop_gradient(disparity)
    nearest = z_buffer(jnp.where(stays, still, -jnp.inf), index)
    wins = stays & (still == nearest[index])
    own = jnp.arange(disparity.size, dtype=jnp.int32)
    winner = jnp.full(disparity.size + 1, disparity.size, jnp.int32)
    winner = winner.at[jnp.where(wins, index, disparity.size).ravel()].min(own)[:-1]
    hit = winner < disparity.size
    source = jnp.where(hit, winner, 0)
    moved = jnp.where(hit[:, None], image.reshape(-1, image.shape[-1])[source], 0)
    depth = jnp.where(hit, disparity.ravel()[source], 0)
    return ForwardWarp(moved.reshape(image.shape), depth.reshape(shape), hit.reshape(shape))
