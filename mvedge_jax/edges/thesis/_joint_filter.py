"""The joint spatial, disparity and color filter of the thesis."""

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import accepts_numpy
from mvedge_jax.image import nearest_pixels


@accepts_numpy
def joint_filter(
    xy: Float[Array, "n 2"],
    disparity: Float[Array, " n"],
    valid: Bool[Array, " n"],
    color: Float[Array, "y x c"],
    space_sigma: Float[Array, ""],
    disparity_sigma: Float[Array, ""],
    color_sigma: Float[Array, ""],
    *,
    radius: int = 5,
) -> Float[Array, " n"]:
    """Averages the disparities of points that are near in space, disparity and color.

    `f(p) = sum_q N(|p - q|) N(d_p - d_q) N(|c_p - c_q|) d_q / W` over the other points of a square
    window. Points are on their nearest pixels, one per pixel; a point without neighbors keeps its
    value.

    Args:
        xy: positions, px.
        disparity: px per view step.
        valid: which slots hold a point; others keep their value.
        color: colors of the center view; CIELAB in the thesis, sRGB in [0, 1] in the authors'
            program.
        space_sigma: px; 10 in the thesis; the program has 10 on an image of twice the size.
        disparity_sigma: px per view step; 0.1 in the thesis.
        color_sigma: in the units of `color`; 0.5 in the thesis.
        radius: half side of the window, px.

    Returns:
        Filtered disparities. Differentiable.

    Source: Thesis 4.1.5, Eq. 4.6 with the corrected last factor `q_d`.
    """
    height, width = color.shape[:2]
    row, column, _ = nearest_pixels(xy, (height, width))
    place = jnp.where(valid, row * width + column, height * width)
    nothing = jnp.zeros(height * width, disparity.dtype)
    labels = nothing.at[place].set(disparity, mode="drop").reshape(height, width)
    present = nothing.at[place].set(1, mode="drop").reshape(height, width) > 0
    sigmas = space_sigma, disparity_sigma, color_sigma
    filtered = _filtered(labels, present, color, *sigmas, radius=radius)
    return jnp.where(valid, filtered[row, column], disparity)


def _filtered(
    disparity: Float[Array, "y x"],
    present: Bool[Array, "y x"],
    color: Float[Array, "y x c"],
    space_sigma: Float[Array, ""],
    disparity_sigma: Float[Array, ""],
    color_sigma: Float[Array, ""],
    *,
    radius: int,
) -> Float[Array, "y x"]:
    height, width = disparity.shape
    margin = ((radius, radius), (radius, radius))
    labels = jnp.pad(disparity, margin)
    votes = jnp.pad(present.astype(disparity.dtype), margin)
    colors = jnp.pad(color, (*margin, (0, 0)))
    side = 2 * radius + 1
    offsets = np.array(
        [(j, i) for j in range(side) for i in range(side) if (j, i) != (radius, radius)]
    )

    def add(carry: tuple[Array, Array], offset: Array) -> tuple[tuple[Array, Array], None]:
        total, weight = carry
        y, x = offset[0], offset[1]
        label = lax.dynamic_slice(labels, (y, x), (height, width))
        vote = lax.dynamic_slice(votes, (y, x), (height, width))
        other = lax.dynamic_slice(
            colors, (y, x, jnp.zeros_like(y)), (height, width, color.shape[2])
        )
        far = ((offset - radius).astype(disparity.dtype) ** 2).sum() / space_sigma**2
        deep = ((label - disparity) / disparity_sigma) ** 2
        tint = ((other - color) ** 2).sum(-1) / color_sigma**2
        w = vote * jnp.exp(-0.5 * (far + deep + tint))
        return (total + w * label, weight + w), None

    nothing = jnp.zeros_like(disparity)
    (total, weight), _ = lax.scan(add, (nothing, nothing), jnp.asarray(offsets, jnp.int32))
    enough = present & (weight > 1e-6)
    return jnp.where(enough, total / jnp.where(enough, weight, 1), disparity)
