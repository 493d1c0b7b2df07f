"""Sharpening: a weighted median whose weights follow the image's colours."""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._params import cast, number
from mvedge_jax.color import Factored, factored, solved
from mvedge_jax.image import window_sum

Sharpening = Literal["clip", "median", "quantised", "none"]

# Levels of a flat map are this far apart: derivatives hold its inverse squared.
_CLOSEST = 1e-9


class MedianParams(eqx.Module):
    """Parameters of the weighted median.

    Attributes:
        epsilon: regularisation of the guided filter, in squared units of sRGB.
        slack: with `"clip"`, how far the map may stay from the median, px.
    """

    epsilon: Float[Array, ""] = number(1e-6, "sRGB²")
    slack: Float[Array, ""] = number(0.03, "px")


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


def weighted_median(
    values: Float[Array, "y x"],
    guide: Float[Array, "c y x"],
    epsilon: Float[Array, ""],
    *,
    radius: int,
    levels: int,
    quantised: bool = False,
) -> Float[Array, "y x"]:
    r"""Median over a window, weighted as a guided filter weighs.

    The share of weight at or below a level is the guided filter's answer to the slice
    $[v \le \ell]$; the median is the level at which it crosses one half. A ramp one slice wide
    instead of the sharp slice, and linear interpolation between levels, give a continuous value.

    Args:
        values: image to filter, `[y, x]`.
        guide: image with three channels that steers the weights, `[c, y, x]`.
        epsilon: regularisation of the guide's covariance.
        radius: of the window, px.
        levels: number of slices between the least and the largest value.
        quantised: return the first level past one half.

    Returns:
        The median, `[y, x]`. Differentiable at the levels chosen.
    """
    # Planes of their own: derivatives of a stack would be put together anew at every level.
    colours = tuple(guide)
    model = _local_model(colours, epsilon, radius)
    low, high = jnp.min(values), jnp.max(values)
    spacing = jnp.maximum((high - low) / (levels - 1), _CLOSEST)

    @jax.checkpoint
    def cross(
        state: tuple[Array, Array, Array], index: Array
    ) -> tuple[tuple[Array, Array, Array], None]:
        before, found, result = state
        level = low + spacing * index.astype(values.dtype)
        if quantised:
            piece = (values <= level + 0.5 * spacing).astype(values.dtype)
        else:
            piece = jnp.clip((level - values) / spacing + 0.5, 0, 1)
        share = _guided(piece, colours, model, radius)
        now = (share >= 0.5) & ~found
        gain = share - before
        part = (0.5 - before) / jnp.where(gain > 0, gain, 1)
        place = level if quantised else level - spacing * (1 - jnp.clip(part, 0, 1))
        return (share, found | now, jnp.where(now, place, result)), None

    start = (jnp.zeros_like(values), values > high, jnp.full_like(values, high))
    (_, _, result), _ = lax.scan(cross, start, jnp.arange(levels))
    return jnp.clip(result, low, high)


class _LocalModel(NamedTuple):
    """Mean of the guide around every pixel, its covariance; the window's area."""

    mean: tuple[Array, ...]
    covariance: Factored
    area: Array


def _local_model(guide: tuple[Array, ...], epsilon: Array, radius: int) -> _LocalModel:
    area = _box_sum(jnp.ones_like(guide[0]), radius)
    mean = tuple(_box_sum(c, radius) / area for c in guide)

    def moment(i: int, j: int) -> Array:
        return _box_sum(guide[i] * guide[j], radius) / area - mean[i] * mean[j]

    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    covariance = factored([moment(i, j) for i, j in pairs], epsilon)
    return _LocalModel(mean, covariance, area)


def _guided(piece: Array, guide: tuple[Array, ...], model: _LocalModel, radius: int) -> Array:
    """The guided filter of one slice."""
    mean = _box_sum(piece, radius) / model.area
    covariance = [
        _box_sum(guide[c] * piece, radius) / model.area - model.mean[c] * mean for c in range(3)
    ]
    slope = solved(model.covariance, covariance)
    offset = mean
    for c in range(3):
        offset = offset - slope[c] * model.mean[c]
    answer = _box_sum(offset, radius)
    for c in range(3):
        answer = answer + _box_sum(slope[c], radius) * guide[c]
    return answer / model.area


def _box_sum(image: Float[Array, "y x"], radius: int) -> Float[Array, "y x"]:
    """Sum over a square window cut at the border."""
    rows = window_sum(image, radius, 0, border="constant")
    return window_sum(rows, radius, 1, border="constant")
