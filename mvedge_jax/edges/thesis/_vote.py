"""The spatial vote of the thesis."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float


def spatial_vote(
    disparity: Float[Array, "y x"],
    confidence: Float[Array, "y x"],
    present: Bool[Array, "y x"],
    tolerance: Float[Array, ""],
) -> Float[Array, "y x"]:
    """Confidence times the share of the neighborhood with the same disparity (Eq. 4.2, left).

    `c_i |A(l_i)| / (p q)`, where A counts the lines, `l_i` among them, within a window of a
    fifteenth of the image whose disparity is equal within a tolerance; confidences are divided by
    their maximum.

    Args:
        disparity: px per view step, one line per pixel at most.
        confidence: filter response.
        present: which pixels carry a line.
        tolerance: px per view step; the authors' code has 1 / (views - 1).

    Source: Thesis 4.1.3, Eq. 4.1 and 4.2.
    """
    height, width = disparity.shape
    half_y, half_x = max(1, height // 30), max(1, width // 30)
    margin = ((half_y, half_y), (half_x, half_x))
    labels = jnp.pad(disparity, margin)
    votes = jnp.pad(present, margin)
    columns = 2 * half_x + 1
    rows = 2 * half_y + 1

    def add(i: Array, count: Array) -> Array:
        corner = (i // columns, i % columns)
        label = lax.dynamic_slice(labels, corner, (height, width))
        vote = lax.dynamic_slice(votes, corner, (height, width))
        same = vote & (jnp.abs(label - disparity) < tolerance)
        return count + same.astype(count.dtype)

    count = lax.fori_loop(0, rows * columns, add, jnp.zeros_like(disparity))
    largest = jnp.maximum(jnp.where(present, confidence, 0).max(), 1e-12)
    return jnp.where(present, confidence / largest * count / (rows * columns), 0)
