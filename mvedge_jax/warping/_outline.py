"""Outlines: which of two surfaces a pixel beside a depth step shows."""

from functools import partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from mvedge_jax._cpu import unstack
from mvedge_jax._params import accepts_numpy, at_least, cast, number
from mvedge_jax.color import factored, solved, srgb_to_linear
from mvedge_jax.image import highest_beside

from ._blocks import in_blocks

# Pairs of color channels, in the order of `factored`.
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


class Outline(eqx.Module):
    """Parameters of the choice of a surface by color beside a depth step.

    All are thresholds: no gradient passes through an outline.

    Attributes:
        odds: prior odds that the map has a pixel beside a step on the right side.
        step: differences of disparity beyond this are steps.
        steeper: least ratio of a step to the slope of either surface per pixel.
        width: standard deviation of the Gaussian window of the color fit.
        doubt: weight of pixels beside a step, whose surface is uncertain.
        faint: variance of colors that tells nothing.
        reach: radius of the window of the color fit, px.
    """

    odds: Float[Array, ""] = number(8.0, "log odds", threshold=True)
    step: Float[Array, ""] = number(0.1, "px", threshold=True)
    steeper: Float[Array, ""] = number(4.0, "rises", threshold=True)
    width: Float[Array, ""] = number(1.8, "px", threshold=True)
    doubt: Float[Array, ""] = number(0.05, "sure pixels", threshold=True)
    faint: Float[Array, ""] = number(1e-5, "squared linear light", threshold=True)
    reach: int = eqx.field(static=True, default=3)

    def __check_init__(self) -> None:
        at_least(self, reach=1)


@accepts_numpy
def outline(
    disparity: Float[Array, "y x"],
    view: Float[Array, "c y x"],
    noise: Float[Array, ""],
    params: Outline,
) -> Int[Array, "y x"]:
    r"""Decides by color which surface the pixels beside a depth step show.

    A pixel is put into one surface, and shows two that meet in it. Light adds up: its color in
    linear light is that of the front times the share $\alpha$ that the front covers, plus that of
    the back times the rest (by sRGB values, bright surfaces would grow). As in closed-form matting,
    $\alpha$ is linear in color nearby. The line is fitted to the pixels around, 1 in front and 0
    behind, those beside a step counting little, and what it leaves unexplained, a variance $r$,
    says how far to believe it: the log odds that the front holds the pixel's middle are
    $(\alpha - 1/2) / r$.

    Args:
        disparity: px per view step, larger is nearer, `[y, x]`.
        view: the picture that it belongs to, sRGB, three channels `[c, y, x]`.
        noise: standard deviation of the picture's noise, sRGB.
        params: see `Outline`.

    Returns:
        Flat index of the pixel whose disparity every pixel should have, its own or one of its eight
        neighbors'. Pixels between two surfaces are given to one of them. A selection: no gradient
        passes.

    Source: the linear model of colors is that of Levin, Lischinski and Weiss, A Closed-Form
        Solution to Natural Image Matting (2008); its use here is ours.

    Example:
        >>> import jax.numpy as jnp
        >>> step = jnp.broadcast_to(jnp.where(jnp.arange(16) < 8, 1.0, 0.0), (16, 16))
        >>> light = jnp.where(jnp.arange(16) == 7, 0.1, step)  # mostly background
        >>> view = jnp.broadcast_to(light, (3, 16, 16))
        >>> step.ravel()[outline(step, view, jnp.asarray(0.0), Outline(odds=1.0))][8, 5:10].tolist()
        [1.0, 1.0, 0.0, 0.0, 0.0]
    """
    disparity, view = lax.stop_gradient(disparity), lax.stop_gradient(view)
    noise, params = lax.stop_gradient((noise, cast(params, disparity.dtype)))
    own = jnp.arange(disparity.size, dtype=jnp.int32).reshape(disparity.shape)
    front, nearer = highest_beside(disparity, own)
    back, farther = highest_beside(-disparity, own)
    back = -back
    rise = _rise(disparity).ravel()
    steep = params.steeper * jnp.maximum(rise[nearer], rise[farther])
    step = front - back > params.step
    beside = step & (front - back > steep)
    middle = 0.5 * (front + back)
    sure = jnp.where(step, params.doubt, 1).astype(disparity.dtype)
    images = jnp.stack([disparity, middle, sure, *srgb_to_linear(view)])
    stencil = partial(_share, params=params, faint=params.faint + noise**2)
    share, unexplained = in_blocks(stencil, beside, images, reach=params.reach)
    ahead = disparity > middle
    believed = jnp.where(ahead, params.odds, -params.odds) * unexplained
    chosen = share - 0.5 + believed > 0
    value, index = jnp.where(chosen, front, back), jnp.where(chosen, nearer, farther)
    astray = jnp.abs(disparity - value) > params.step
    return jnp.where(beside & astray, index, own)


def _rise(disparity: Array) -> Array:
    """What a surface rises by per pixel, the less of both sides; 0 on crests and in cracks."""
    rise = jnp.zeros_like(disparity)
    for axis in (0, 1):
        margin = [(0, 0), (0, 0)]
        margin[axis] = (1, 1)
        steps = jnp.diff(jnp.pad(disparity, margin, mode="edge"), axis=axis)
        size = disparity.shape[axis]
        before, after = (lax.slice_in_dim(steps, k, k + size, axis=axis) for k in (0, 1))
        less = jnp.minimum(jnp.abs(before), jnp.abs(after))
        rise = jnp.maximum(rise, jnp.where(before * after > 0, less, 0))
    return rise


def _share(images: Array, *, params: Outline, faint: Array) -> Array:
    """The share of a pixel that the front covers, by its color, and the variance of the fit.

    Both, `[b, 2, y, x]`, from disparity, that of the middle between front and back, certainty and
    linear colors with a margin of `Outline.reach`, `[b, 6, y, x]`. A variance of colors of `faint`
    tells nothing.
    """
    reach = params.reach
    height, width = (size - 2 * reach for size in images.shape[-2:])
    planes = jnp.moveaxis(images, 1, 0)
    _, middle, _, *own = unstack(planes[..., reach : reach + height, reach : reach + width])
    square = np.arange(-reach, reach + 1) ** 2
    distance = square[:, None] + square
    gaussian = jnp.exp(-0.5 * jnp.asarray(distance, images.dtype) / params.width**2)
    gaussian = jnp.where(distance <= reach**2 + 1, gaussian, 0)

    # Sums of 1, colors, products of colors; of the front, and of its colors. Rows are added by
    # a loop: written out, they would be a tenth of the instructions of the whole chain.
    def add(sums: list[Array], row: tuple[Array, Array]) -> tuple[list[Array], None]:
        place, factors = row
        around = lax.dynamic_slice_in_dim(planes, place, height, axis=2)
        for dx in range(2 * reach + 1):
            value, _, known, *colors = unstack(around[..., dx : dx + width])
            weight = factors[dx] * known
            # From the pixel's own color, as differences of large sums would be inexact.
            colors = [a - b for a, b in zip(colors, own, strict=True)]
            front = jnp.where(value > middle, weight, 0)
            terms = [weight, *(weight * c for c in colors)]
            terms += [weight * colors[i] * colors[j] for i, j in _PAIRS]
            terms += [front, *(front * c for c in colors)]
            sums = [total + term for total, term in zip(sums, terms, strict=True)]
        return sums, None

    rows = jnp.arange(2 * reach + 1), gaussian
    sums, _ = lax.scan(add, [jnp.zeros_like(middle)] * 14, rows)
    total = sums[0]
    mean = [s / total for s in sums[1:4]]
    moments = [s / total - mean[i] * mean[j] for s, (i, j) in zip(sums[4:10], _PAIRS, strict=True)]
    ahead = sums[10] / total
    along = [s / total - ahead * m for s, m in zip(sums[11:], mean, strict=True)]
    slope = solved(factored(moments, faint), along)
    share = ahead - sum(s * m for s, m in zip(slope, mean, strict=True))
    explained = sum(s * a for s, a in zip(slope, along, strict=True))
    return jnp.stack([share, jnp.maximum(ahead * (1 - ahead) - explained, 0)], axis=1)
