"""A weighted median whose weights follow an image's colors."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._checkpoint import save_residual
from mvedge_jax._cpu import no_fuse
from mvedge_jax._linear_map import linear_map
from mvedge_jax._params import accepts_numpy
from mvedge_jax._root import LEAST_DIVISOR
from mvedge_jax.color import Factored, factored, solved
from mvedge_jax.image import window_sum


@accepts_numpy
def weighted_median(
    values: Float[Array, "y x"],
    guide: Float[Array, "c y x"],
    epsilon: Float[Array, ""],
    *,
    radius: int,
    levels: int,
    quantized: bool = False,
    ends: tuple[Float[Array, ""], Float[Array, ""]] | None = None,
) -> Float[Array, "y x"]:
    r"""Median over a window, with the weights of a guided filter.

    The guided filter, applied to the slice $[v \le \ell]$, gives the share of weight at or below
    level $\ell$; the median is the level at which the share crosses one half. A ramp one slice wide
    instead of the sharp slice, and linear interpolation between levels, give a continuous value.

    Args:
        values: image to filter, `[y, x]`.
        guide: image with three channels that steers the weights, `[c, y, x]`.
        epsilon: regularization of the guide's covariance.
        radius: radius of the window, px.
        levels: number of slices between the least and the largest value.
        quantized: return the first level past one half.
        ends: first and last level; None for the least and the largest value.

    Returns:
        The median, `[y, x]`. Differentiable, in both modes, at the levels chosen.
    """
    low, high = (jnp.min(values), jnp.max(values)) if ends is None else ends
    spacing = jnp.maximum((high - low) / (levels - 1), LEAST_DIVISOR)
    sliced, still = _prepared(values, low, spacing, guide, epsilon, radius)
    slices = _Slices(radius, levels, quantized)
    if quantized:
        found = lax.stop_gradient(_search(slices, sliced, still))
        place = low + spacing * found.level
    else:
        found = _crossing(slices, sliced, still)
        gain = found.share - found.before
        part = (0.5 - found.before) / jnp.where(gain > 0, gain, 1)
        place = low + spacing * (found.level - (1 - jnp.clip(part, 0, 1)))
    return jnp.clip(jnp.where(found.level < levels, place, high), low, high)


class _Slices(NamedTuple):
    """Static options of a median."""

    radius: int
    levels: int
    quantized: bool


class _Sliced(NamedTuple):
    """The arrays with respect to which the shares of a slice are differentiated.

    Attributes:
        values: `[y, x]`.
        low: the first level.
        spacing: spacing of the levels.
        guide: channels of the guide, not stacked: a stack's derivative would be assembled at every
            level.
        mean: of the channels around every pixel.
        moments: their covariances, see `Factored`.
    """

    values: Array
    low: Array
    spacing: Array
    guide: tuple[Array, ...]
    mean: tuple[Array, ...]
    moments: tuple[Array, ...]


class _Still(NamedTuple):
    """Factors of the covariances, and the windows' areas."""

    factors: tuple[Array, ...]
    area: Array


class _Crossing(NamedTuple):
    """Where the share of weight below a level reaches one half.

    Attributes:
        level: index of the first level at which it does, as a float; the number of levels if there
            is none.
        share: share of weight at this level.
        before: share at the previous level; 0 for the first.
    """

    level: Array
    share: Array
    before: Array


def _prepared(
    values: Array, low: Array, spacing: Array, guide: Array, epsilon: Array, radius: int
) -> tuple[_Sliced, _Still]:
    """The guide's means and covariances around every pixel."""
    colors = tuple(guide)
    area = _box_sum(jnp.ones_like(values), radius)
    mean = tuple(_box_sum(c, radius) / area for c in colors)

    def moment(i: int, j: int) -> Array:
        return _box_sum(colors[i] * colors[j], radius) / area - mean[i] * mean[j]

    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    covariance = factored([moment(i, j) for i, j in pairs], epsilon)
    sliced = _Sliced(values, low, spacing, colors, mean, covariance.moments)
    return sliced, _Still(covariance.factors, area)


def _search(slices: _Slices, sliced: _Sliced, still: _Still) -> _Crossing:
    def cross(state: tuple[Array, _Crossing], level: Array) -> tuple[tuple[Array, _Crossing], None]:
        before, found = state
        share = _share(slices, level, sliced, still)
        now = (share >= 0.5) & (found.level == slices.levels)
        new = _Crossing(jnp.broadcast_to(level, share.shape), share, before)
        return (share, jax.tree.map(partial(jnp.where, now), new, found)), None

    nothing = jnp.zeros_like(sliced.values)
    start = nothing, _Crossing(jnp.full_like(nothing, slices.levels), nothing, nothing)
    return lax.scan(cross, start, _levels(slices, sliced))[0][1]


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _crossing(slices: _Slices, sliced: _Sliced, still: _Still) -> _Crossing:
    """`_search` with a derivative rule that does not differentiate the scan's carry."""
    return _search(slices, sliced, still)


@_crossing.defjvp
def _crossing_jvp(slices: _Slices, primals: Any, tangents: Any) -> tuple[_Crossing, _Crossing]:
    found = save_residual(_search(slices, *primals))

    def pushed(fixed: Any, moving: _Sliced) -> tuple[Array, Array]:
        sliced, still, chosen = fixed

        def step(total: tuple[Array, Array], level: Array) -> tuple[tuple[Array, Array], None]:
            share = jax.jvp(lambda s: _share(slices, level, s, still), (sliced,), (moving,))[1]
            at, before = total
            at = jnp.where(chosen == level, share, at)
            return (at, jnp.where(chosen == level + 1, share, before)), None

        nothing = jnp.zeros_like(chosen)
        return lax.scan(step, (nothing, nothing), _levels(slices, sliced))[0]

    def pulled(fixed: Any, cotangent: tuple[Array, Array]) -> _Sliced:
        sliced, still, chosen = fixed
        at, before = cotangent

        def step(total: _Sliced, level: Array) -> tuple[_Sliced, None]:
            wanted = jnp.where(chosen == level, at, jnp.where(chosen == level + 1, before, 0))
            more = _pulled_share(slices, level, sliced, still, wanted)
            return jax.tree.map(jnp.add, total, more), None

        nothing = jax.tree.map(jnp.zeros_like, sliced)
        total = lax.scan(step, nothing, _levels(slices, sliced))[0]
        mean, moments = (tuple(still.area * m for m in of) for of in (total.mean, total.moments))
        return total._replace(mean=mean, moments=moments)

    moved = linear_map(pushed, pulled, (*primals, found.level), tangents[0])
    return found, _Crossing(jnp.zeros_like(found.level), *moved)


def _levels(slices: _Slices, sliced: _Sliced) -> Float[Array, " l"]:
    return jnp.arange(slices.levels, dtype=sliced.values.dtype)


def _share(slices: _Slices, level: Array, sliced: _Sliced, still: _Still) -> Float[Array, "y x"]:
    """Share of weight at or below a level: the guided filter of a slice."""
    ramp = _ramp(level, sliced)
    piece = (ramp >= 0).astype(ramp.dtype) if slices.quantized else jnp.clip(ramp, 0, 1)
    mean, slope = _regressed(_sums(piece, sliced.guide, slices.radius), sliced, still)
    answer = _box_sum(_offset(mean, slope, sliced), slices.radius)
    for s, c in zip(slope, sliced.guide, strict=True):
        answer = answer + _box_sum(s, slices.radius) * c
    return answer / still.area


def _ramp(level: Array, sliced: _Sliced) -> Array:
    """The unclipped ramp of a slice: it rises from 0 to 1 around its level."""
    return (sliced.low + sliced.spacing * level - sliced.values) / sliced.spacing + 0.5


def _sums(piece: Array, guide: tuple[Array, ...], radius: int) -> list[Array]:
    """Window sums of a map and of its products with the guide's channels."""
    return [_box_sum(m, radius) for m in (piece, *(c * piece for c in guide))]


def _regressed(
    sums: list[Array], sliced: _Sliced, still: _Still
) -> tuple[Array, tuple[Array, ...]]:
    """Local mean of a map and its slopes in the guide's channels, from `_sums`."""
    mean, *products = (total / still.area for total in sums)
    covariance = [p - m * mean for p, m in zip(products, sliced.mean, strict=True)]
    return mean, solved(Factored(sliced.moments, still.factors), covariance)


def _offset(mean: Array, slope: tuple[Array, ...], sliced: _Sliced) -> Array:
    """Intercept of a regression: its value where the guide is 0."""
    for s, m in zip(slope, sliced.mean, strict=True):
        mean = mean - s * m
    return mean


def _pulled_share(
    slices: _Slices, level: Array, sliced: _Sliced, still: _Still, wanted: Array
) -> _Sliced:
    """The transpose of a share's derivative, by hand: JAX's takes twice the time.

    The filter is its own transpose up to the window areas: cotangents are regressed on the guide
    like the slice, and both slopes give the cotangents of means and moments. The caller multiplies
    these by the areas.
    """

    def both(piece: Array, wanted: Array, guide: tuple[Array, ...]) -> tuple[list[Array], ...]:
        return _sums(piece, guide, slices.radius), _sums(wanted, guide, slices.radius)

    def spread(*maps: Array) -> list[Array]:
        return [_box_sum(m, slices.radius) for m in maps]

    ramp = _ramp(level, sliced)
    piece, wanted = jnp.clip(ramp, 0, 1), wanted / still.area
    # Stored; otherwise XLA recomputes the sums for each of their readers.
    of_piece, of_wanted = no_fuse(both, piece, wanted, sliced.guide)
    mean, slope = _regressed(of_piece, sliced, still)
    around, turned = _regressed(of_wanted, sliced, still)
    back, *by_color = no_fuse(spread, _offset(around, turned, sliced), *turned)
    for c, b in zip(sliced.guide, by_color, strict=True):
        back = back + c * b
    change = jnp.where((ramp > 0) & (ramp < 1), back, 0) / sliced.spacing
    (r, g, b), (tr, tg, tb) = slope, turned
    moments = (tr * r, tr * g + tg * r, tr * b + tb * r, tg * g, tg * b + tb * g, tb * b)
    return _Sliced(
        values=-change,
        low=jnp.sum(change),
        spacing=jnp.sum(change * (level + 0.5 - ramp)),
        guide=tuple(
            piece * b + wanted * s for b, s in zip(by_color, no_fuse(spread, *slope), strict=True)
        ),
        mean=tuple(-(s * around + t * mean) for s, t in zip(slope, turned, strict=True)),
        moments=tuple(-m for m in moments),
    )


def _box_sum(image: Float[Array, "y x"], radius: int) -> Float[Array, "y x"]:
    """Sum over a square window cut at the border."""
    rows = window_sum(image, radius, 0, border="constant")
    return window_sum(rows, radius, 1, border="constant")
