"""Forward projection of disparity maps with a depth test."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


def project(
    disparity: Float[Array, "y x"], step: Float[Array, "2"]
) -> tuple[Int[Array, "y x"], Bool[Array, "y x"]]:
    """The pixel of the view `step` away on which each pixel lands.

    Args:
        disparity: `[y, x]`, px per view step, finite.
        step: View steps `(s_x, s_y)`, as for `warping.backward_warp`.

    Returns:
        Row-major index of the nearest pixel (0 outside), and whether it lies inside the image.
    """
    height, width = disparity.shape
    x = jnp.round(jnp.arange(width, dtype=disparity.dtype)[None, :] + step[0] * disparity)
    y = jnp.round(jnp.arange(height, dtype=disparity.dtype)[:, None] + step[1] * disparity)
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    index = jnp.where(inside, y, 0).astype(jnp.int32) * width
    return index + jnp.where(inside, x, 0).astype(jnp.int32), inside


def nearest_disparity(
    disparity: Float[Array, "y x"], step: Float[Array, "2"]
) -> Float[Array, "y x"]:
    """The disparity map as the view `step` away sees it.

    Every pixel moves to the nearest pixel of the other view; the largest disparity wins.

    Args:
        disparity: `[y, x]`, px per view step, finite.
        step: View steps `(s_x, s_y)`, as for `warping.backward_warp`.

    Returns:
        `[y, x]`, px per view step; minus infinity in holes.
    """
    index, inside = project(disparity, step)
    # Unique positions are not promised; what falls outside is dropped, not clamped.
    target = jnp.where(inside, index, disparity.size).ravel()
    empty = jnp.full(disparity.size, -jnp.inf, disparity.dtype)
    return empty.at[target].max(disparity.ravel(), mode="drop").reshape(disparity.shape)
