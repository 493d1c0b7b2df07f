"""Which pixels of this view another view sees."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import accepts_numpy

from ._forward import landing, z_buffer


@accepts_numpy
def visible(
    disparity: Float[Array, "y x"],
    step: Float[Array, "2"],
    *,
    tolerance: Float[Array, ""] | float = 0.1,
) -> Bool[Array, "y x"]:
    """Tells which points another view sees, by an exact z-buffer.

    A point is hidden if one that is nearer by more than `tolerance` lands on the same pixel. The
    tolerance keeps slanted surfaces, whose pixels crowd in the other view, from hiding
    themselves.

    Args:
        disparity: px per view step, larger is nearer.
        step: `(u_c - u, v_c - v)` of the other view.
        tolerance: px per view step.

    Returns:
        False where the point leaves the view, is hidden, or has no finite disparity. No
        gradient.

    Source:
        Thesis 7.1.4, the mask of Eq. 7.15.
    """
    disparity = jax.lax.stop_gradient(disparity)
    index, stays = landing(disparity, step)
    key = jnp.where(stays, disparity, -jnp.inf)
    nearest = z_buffer(key, index)[index]
    return stays & (nearest <= key + jnp.asarray(tolerance).astype(key.dtype))


@accepts_numpy
def visible_binned(
    disparity: Float[Array, "y x"],
    step: Float[Array, "2"],
    *,
    bins: int = 32,
    limit: Float[Array, ""] | float = 5.0,
) -> Bool[Array, "y x"]:
    """Tells which points another view sees, with disparities quantized as the authors do.

    A point is hidden if one from a strictly nearer bin lands on the same pixel. Bins spread over
    the range of the map: surfaces within one bin never hide each other.

    Args:
        disparity: px per view step, larger is nearer.
        step: `(u_c - u, v_c - v)` of the other view.
        bins: number of bins.
        limit: disparities are clamped to ± this, px, before they are binned.

    Returns:
        False where the point leaves the view, is hidden, or has no finite disparity. No
        gradient.

    Source:
        Thesis 7.1.4; the bins are those of the authors' published code.
    """
    disparity = jax.lax.stop_gradient(disparity)
    index, stays = landing(disparity, step)
    bound = jnp.asarray(limit).astype(disparity.dtype)
    finite = jnp.isfinite(disparity)
    clamped = jnp.clip(jnp.where(finite, disparity, 0), -bound, bound)
    low = jnp.min(clamped, where=finite, initial=bound)
    high = jnp.max(clamped, where=finite, initial=-bound)
    spread = jnp.where(high > low, high - low, 1)
    level = jnp.minimum(jnp.floor((clamped - low) / spread * bins), bins - 1)
    key = jnp.where(stays, level, -jnp.inf)
    return stays & (z_buffer(key, index)[index] <= key)
