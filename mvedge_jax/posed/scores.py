"""Errors of a depth map whose unit may be free."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from mvedge_jax._params import accepts_numpy

# Pixels at which the thesis fits a scale.
_SAMPLES = 500


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
        depth: in the unit of the truth. Pixels that are not finite or not positive count as wrong,
            in the squares with an error of the median depth.
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


@accepts_numpy
def scale_to(
    depth: Float[Array, "y x"], truth: Float[Array, "y x"], *, key: PRNGKeyArray
) -> Float[Array, ""]:
    """The factor that brings a depth map closest to the truth, at 500 random pixels.

    Args:
        depth: in any unit.
        truth: not finite or 0 where unknown.
        key: random key of the choice of pixels, among those known in both maps.

    Returns:
        The factor, by least squares. Differentiable in both maps.

    Source: Thesis 7.2.2, "Baselines and Metrics".
    """
    known = (jnp.isfinite(truth) & (truth > 0) & jnp.isfinite(depth) & (depth > 0)).reshape(-1)
    order = jnp.where(known, jax.random.uniform(key, known.shape), jnp.inf)
    chosen = jnp.argsort(order)[: min(_SAMPLES, known.size)]
    weight = known[chosen].astype(depth.dtype)
    own = jnp.where(weight > 0, depth.reshape(-1)[chosen], 1)
    true = jnp.where(weight > 0, truth.reshape(-1)[chosen].astype(depth.dtype), 1)
    return jnp.sum(weight * own * true) / jnp.sum(weight * own**2)
