"""Sharpening: depth steps are moved onto colour steps."""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._params import accepts_numpy, cast, number

from ._median import weighted_median

Sharpening = Literal["clip", "median", "quantised", "none"]


class MedianParams(eqx.Module):
    """Parameters of the weighted median.

    Attributes:
        epsilon: regularisation of the guided filter, in squared units of sRGB.
        slack: with `"clip"`, how far the map may stay from the median, px.
    """

    epsilon: Float[Array, ""] = number(1e-6, "sRGB²")
    slack: Float[Array, ""] = number(0.03, "px")


@accepts_numpy
def sharpen(
    disparity: Float[Array, "y x"],
    guide: Float[Array, "c y x"],
    params: MedianParams,
    *,
    radius: int = 7,
    levels: int = 48,
    mode: Sharpening = "clip",
) -> Float[Array, "y x"]:
    """Moves blurred depth steps onto the colour steps beside them.

    Args:
        disparity: px per view step, `[y, x]`.
        guide: the centre view, sRGB, three channels `[c, y, x]`.
        params: see `MedianParams`.
        radius: of the guided filter, px.
        levels: slices of the range of disparities.
        mode: `"median"` interpolates the median between slices; `"clip"` keeps the map where it
            is within `slack` of that median, and so its precision; `"quantised"` returns the slice
            itself, as the thesis does; `"none"` changes nothing.

    Returns:
        The sharpened map. Differentiable; which level crosses one half is a selection.

    Raises:
        ValueError: `mode` is unknown.

    Source: Thesis 6.1, "Cross-hair View Projection"; the interpolation and the clip are ours.

    Example:
        >>> import jax.numpy as jnp
        >>> step = jnp.where(jnp.arange(32) < 16, 0.0, 1.0)
        >>> guide = jnp.broadcast_to(step, (3, 16, 32))
        >>> blurred = jnp.broadcast_to(jnp.clip(jnp.arange(32) / 8 - 1.5, 0.0, 1.0), (16, 32))
        >>> sharp = sharpen(blurred, guide, MedianParams())
        >>> [round(float(jnp.abs(m - step[None]).max()), 2) for m in (blurred, sharp)]
        [0.5, 0.18]
    """
    if mode == "none":
        return disparity
    if mode not in ("clip", "median", "quantised"):
        raise ValueError(f"`mode` must be 'clip', 'median', 'quantised' or 'none'; it is {mode!r}.")
    params = cast(params, disparity.dtype)
    median = weighted_median(
        disparity,
        guide,
        params.epsilon,
        radius=radius,
        levels=levels,
        quantised=mode == "quantised",
    )
    if mode == "clip":
        return jnp.clip(disparity, median - params.slack, median + params.slack)
    return median
