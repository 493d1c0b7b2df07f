"""The center view's map moved to every view, and nothing else."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax.warping import holes, z_buffer


@jax.jit
def reproject_views(
    disparity: Float[Array, "y x"], steps: Float[Array, "v u 2"]
) -> Float[Array, "v u y x"]:
    """Disparity of every view by moving the pixels of the center view's map.

    Every pixel goes to the nearest pixel of the view, halves upwards; the nearest surface wins. A
    hole takes the smallest of its nearest filled neighbors to the left, to the right, above and
    below.

    Args:
        disparity: of the center view, px per view step.
        steps: `(u_c - u, v_c - v)` of every view, as `LightField.steps`.

    Returns:
        Maps of all views. Differentiable with respect to `disparity`; which pixel goes where is a
        selection.

    Source: Thesis 6.1, what it calls naive.

    Example:
        >>> import jax.numpy as jnp
        >>> steps = jnp.array([[[1.0, 0.0], [0.0, 0.0], [-1.0, 0.0]]])
        >>> reproject_views(jnp.array([[0.0, 1.0, 0.0, 0.0]]), steps)[0, :, 0].tolist()
        [[0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]]
    """
    height, width = disparity.shape
    still = lax.stop_gradient(disparity)
    columns = jnp.arange(width, dtype=disparity.dtype)[None]
    rows = jnp.arange(height, dtype=disparity.dtype)[:, None]
    own = jnp.arange(disparity.size, dtype=jnp.int32).reshape(disparity.shape)

    def move(step: Array) -> Array:
        x = jnp.floor(columns + step[0] * still + 0.5).astype(jnp.int32)
        y = jnp.floor(rows + step[1] * still + 0.5).astype(jnp.int32)
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        index = jnp.where(inside, y * width + x, disparity.size)
        nearest = z_buffer(still, index)
        place = jnp.where(still == nearest[index], index, disparity.size)
        winner = jnp.zeros(disparity.size + 1, jnp.int32).at[place.ravel()].set(own.ravel())
        nearest = nearest[:-1].reshape(disparity.shape)
        source = holes(nearest, jnp.isfinite(nearest)).behind
        return disparity.ravel()[winner[source]]

    moved = lax.map(move, steps.reshape(-1, 2).astype(disparity.dtype))
    return moved.reshape(*steps.shape[:2], height, width)
