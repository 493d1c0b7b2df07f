"""The joint spatial, disparity and colour filter of the thesis."""

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import accepts_numpy


@accepts_numpy
def joint_filter(
    disparity: Float[Array, "y x"],
    present: Bool[Array, "y x"],
    colour: Float[Array, "y x c"],
    space_sigma: Float[Array, ""],
    disparity_sigma: Float[Array, ""],
    colour_sigma: Float[Array, ""],
    *,
    radius: int = 5,
) -> Float[Array, "y x"]:
    """Averages the disparities of neighbours that are near in space, disparity and colour.

    `f(p) = sum_q N(|p - q|) N(d_p - d_q) N(|c_p - c_q|) d_q / W` over the other points of a square
    window; a point without neighbours keeps its value.

    Args:
        disparity: px per view step, one point per pixel at most.
        present: which pixels carry a point.
        colour: sRGB in [0, 1], of the centre view.
        space_sigma: px; the authors' code has 5 (10 on an image of twice the size).
        disparity_sigma: px per view step; 0.1 in the thesis.
        colour_sigma: 0.5 in the thesis.
        radius: half side of the window, px.

    Returns:
        Filtered disparities; unchanged where there is no point. Differentiable.

    Source: Thesis 4.1.5, Eq. 4.6 with the corrected last factor `q_d`.
    """
    height, width = disparity.shape
    margin = ((radius, radius), (radius, radius))
    labels = jnp.pad(disparity, margin)
    votes = jnp.pad(present.astype(disparity.dtype), margin)
    colours = jnp.pad(colour, (*margin, (0, 0)))
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
            colours, (y, x, jnp.zeros_like(y)), (height, width, colour.shape[2])
        )
        far = ((offset - radius).astype(disparity.dtype) ** 2).sum() / space_sigma**2
        deep = ((label - disparity) / disparity_sigma) ** 2
        tint = ((other - colour) ** 2).sum(-1) / colour_sigma**2
        w = vote * jnp.exp(-0.5 * (far + deep + tint))
        return (total + w * label, weight + w), None

    nothing = jnp.zeros_like(disparity)
    (total, weight), _ = lax.scan(add, (nothing, nothing), jnp.asarray(offsets, jnp.int32))
    enough = present & (weight > 1e-6)
    return jnp.where(enough, total / jnp.where(enough, weight, 1), disparity)
