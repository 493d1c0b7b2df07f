"""Errors of a depth map whose unit may be free."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._params import accepts_numpy


class DepthErrors(NamedTuple):
    """Errors of a depth map.

    Attributes:
        median: of the error relative to the true depth, %.
        above: pixels whose relative error exceeds 2 %, %.
        mse: mean squared error x 100, in the unit of depth.
        q25: first quartile of the absolute error x 100, in the unit of depth.
    """

    median: Float[Array, ""]
    above: Float[Array, ""]
    mse: Float[Array, ""]
    q25: Float[Array, ""]


@accepts_numpy
def depth_errors(depth: Float[Array, "y x"], truth: Float[Array, "y x"]) -> DepthErrors:
    """Compares a depth map with the truth.

    Args:
        depth: in the unit of the truth; where not finite or not positive it is wrong, in the
            squares with an error of the median depth.
        truth: not finite or 0 where unknown.

    Returns:
        The errors; NaN without any known pixel.

    Source: Thesis 7.2.2 for the squares and the quartile.

    Example:
        >>> import jax.numpy as jnp
        >>> found = depth_errors(jnp.asarray([[1.0, 2.1]]), jnp.asarray([[1.0, 2.0]]))
        >>> found.above.round(1).item(), found.mse.round(2).item()
        (50.0, 0.5)
    """
    known = jnp.isfinite(truth) & (truth > 0)
    safe = jnp.where(known, truth, jnp.nan)
    found = jnp.isfinite(depth) & (depth > 0)
    error = jnp.where(found, jnp.abs(depth - safe), jnp.nanmedian(safe))
    error = jnp.where(known, error, jnp.nan)
    relative = 100 * jnp.where(found, error / safe, jnp.where(known, jnp.inf, jnp.nan))
    count = jnp.sum(known)
    above = 100 * jnp.sum(relative > 2) / jnp.maximum(count, 1)
    # A median of infinities would be NaN by interpolation.
    ordered = jnp.sort(jnp.where(known, relative, jnp.inf).reshape(-1))
    median = ordered[jnp.maximum(count - 1, 0) // 2]
    return DepthErrors(
        jnp.where(count > 0, median, jnp.nan),
        jnp.where(count > 0, above, jnp.nan),
        100 * jnp.nanmean(error**2),
        100 * jnp.nanpercentile(error, 25),
    )
