"""Hypotheses: per pixel, the disparity whose views agree best, whatever hides some of them."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._crosshair import Arm
from mvedge_jax._fence import fenced
from mvedge_jax._params import cast, number
from mvedge_jax._unstack import unstack
from mvedge_jax.interpolation import keys_taps, vertex

from .._window import colour_weights, contrast, weighted_sum
from ..brightness._noise import Noise
from ._paths import aggregate
from ._pooling import pooled

# Gradients are looked for within this distance, px: the reach of a window and of its drift.
_OUTLINE = 5
# One, CIELAB per px, near which half of the drift is granted, and soon none: beside an outline, a
# change of mean colour is what shows the wrong hypothesis.
_OUTLINED = 2.0
# Least noise assumed, standard deviation in sRGB.
_LEAST_NOISE = 1 / 255
# Neighbours whose CIELAB colour differs by much more than this take no part in a window.
SAME_COLOUR = 4.0
# Step of CIELAB colour that halves the price of a jump.
COLOUR_OF_JUMPS = 4.0
# How far costs are averaged along a surface where noise rules, px.
POOLING = 20.0


class VolumeParams(eqx.Module):
    """Parameters of the hypotheses.

    Attributes:
        truncation: squared colour differences saturate at this many times the scene's noise, so
            that a view in which the pixel is hidden says nothing, instead of a lot.
        drift: the mean colour of a window may change by this much, sRGB, from the centre view to
            the last one without speaking against a hypothesis: gloss and shading slide over a
            surface. Noise would pass for drift: the more it rules, the less is granted.
        slant: price of a change by one hypothesis between neighbouring pixels; of 2, the cost of a
            pixel that no view confirms.
        jump: price of a larger change between pixels of the same colour.
    """

    truncation: Float[Array, ""] = number(4.0, "noise variances")
    drift: Float[Array, ""] = number(1.5 / 255, "sRGB")
    slant: Float[Array, ""] = number(0.05, "of a cost of at most 2")
    jump: Float[Array, ""] = number(0.8, "of a cost of at most 2")


class _Half(NamedTuple):
    """The views on one side of the centre that a sweep looks at, padded along the arm."""

    planes: Array
    steps: Array
    there: Array


class _Swept(NamedTuple):
    """An arm prepared for a sweep, with the weights of its windows."""

    centre: Array
    halves: tuple[_Half, _Half]
    support: Array
    wide: Array
    share: Array


@partial(jax.jit, static_argnames="window")
def hypotheses(
    horizontal: Arm,
    vertical: Arm,
    lab: Float[Array, "c y x"],
    disparities: Float[Array, " d"],
    params: VolumeParams,
    *,
    window: int,
    noise: Noise | None = None,
) -> Float[Array, "y x"]:
    r"""Per pixel, the disparity at which the views agree best.

    A pixel beside a nearer surface is hidden in the views of one side of each arm. Of each
    arm, therefore, only the half that agrees better counts:
    $\min(C_{left}, C_{right}) + \min(C_{above}, C_{below})$, each a mean of truncated
    squared colour differences to the centre view over a colour-weighted window.

    On glossy and on dark surfaces the colour of a window drifts from view to view, at the true
    disparity by more than its texture differs at a wrong one. Away from outlines, what such a
    window changes in proportion to the view step is therefore taken out, per half, up to a limit.

    These costs are summed along paths through the image, so that pixels that the views say little
    about follow their surroundings; see `aggregate`. Noise makes jumps cheaper, softens the choice
    of the half, and has costs pooled along surfaces first.

    Args:
        horizontal: the horizontal arm, low-passed as the noise asks.
        vertical: the vertical arm, likewise, transposed.
        lab: the centre view in CIELAB, denoised, `[c, y, x]`.
        disparities: what to try, px per view step, increasing, evenly spaced.
        params: see `VolumeParams`.
        window: half the width of the window, px.
        noise: of the views before any low-pass; None for none.

    Returns:
        Disparity per pixel, between the hypotheses by a parabola. Differentiable in all but
        `disparities`' number, at the hypothesis chosen.
    """
    params = cast(params, lab.dtype)
    noise = Noise.of(jnp.zeros((), lab.dtype)) if noise is None else noise
    cost = _matching_cost(horizontal, vertical, lab, params, noise, window)
    cheaper = 1 - 0.75 * noise.alpha
    total = aggregate(
        pooled(lax.map(cost, disparities), lab, noise, jnp.asarray(POOLING, lab.dtype)),
        lab,
        slant=cheaper * params.slant,
        jump=cheaper * params.jump,
        colour=jnp.asarray(COLOUR_OF_JUMPS, lab.dtype),
    )
    return cheapest(total, disparities)


@partial(jax.jit, static_argnames="window")
def best_match(
    horizontal: Arm,
    vertical: Arm,
    lab: Float[Array, "c y x"],
    disparities: Float[Array, " d"],
    params: VolumeParams,
    *,
    window: int,
    noise: Noise | None = None,
) -> tuple[Float[Array, "y x"], Float[Array, "y x"]]:
    """The cheapest hypothesis of every pixel by itself: `hypotheses` without paths and pooling.

    Args:
        horizontal: the horizontal arm.
        vertical: the vertical arm, transposed.
        lab: the centre view in CIELAB, `[c, y, x]`.
        disparities: what to try, px per view step, increasing, evenly spaced.
        params: see `VolumeParams`.
        window: half the width of the window, px.
        noise: of the views; None for none.

    Returns:
        Disparity and its cost per pixel: 0 where the better halves of both arms agree, 2 where no
        view does. Differentiable as `hypotheses`.
    """
    params = cast(params, lab.dtype)
    noise = Noise.of(jnp.zeros((), lab.dtype)) if noise is None else noise
    total = lax.map(_matching_cost(horizontal, vertical, lab, params, noise, window), disparities)
    return cheapest(total, disparities), jnp.min(total, axis=0)


def _matching_cost(
    horizontal: Arm, vertical: Arm, lab: Array, params: VolumeParams, noise: Noise, window: int
) -> Callable[[Array], Array]:
    """The cost of a disparity at every pixel, `[y, x]`, over both arms."""
    alpha = noise.alpha
    truncation = params.truncation * horizontal.planes.shape[1] * noise_variance(noise)
    share = shared_drift(noise, lab)
    across = _swept(horizontal, lab, share, window)
    down = _swept(vertical, jnp.swapaxes(lab, 1, 2), share.T, window)

    @jax.checkpoint
    def cost(disparity: Array) -> Array:
        # Stored before the transposition, or the windows are summed across the rows in memory.
        along_rows, along_columns = (
            fenced(_arm_cost, arm, disparity, truncation, params.drift, alpha)
            for arm in (across, down)
        )
        return along_rows + along_columns.T

    return cost


def noise_variance(noise: Noise) -> Float[Array, ""]:
    """What truncated differences are measured by."""
    # Of views without noise, two thirds of what was measured: texture is in it.
    deviation = noise.deviation * (noise.alpha + (1 - noise.alpha) / 1.45)
    return jnp.maximum(deviation, _LEAST_NOISE) ** 2


def shared_drift(noise: Noise, lab: Float[Array, "c y x"]) -> Float[Array, "y x"]:
    """How much of a window's drift is granted at every pixel, 0..1."""
    return (1 - noise.alpha) / (1 + (contrast(lab, radius=_OUTLINE) / _OUTLINED) ** 4)


def _swept(arm: Arm, lab: Array, share: Array, window: int) -> _Swept:
    alike = jnp.asarray(SAME_COLOUR, lab.dtype)
    # Drift is looked for in a window twice as wide as that of the cost, through as many pixels.
    return _Swept(
        arm.planes[arm.centre],
        _halves(arm),
        colour_weights(lab, alike, reach=window),
        colour_weights(lab, alike, reach=window, spacing=2),
        share,
    )


def _arm_cost(
    arm: _Swept, disparity: Array, truncation: Array, limit: Array, alpha: Array
) -> Array:
    """Cost of the half that agrees better, in units of the truncation."""
    # Stored, because both the drift and the cost read them.
    changes = [fenced(_changes, half, arm.centre, disparity) for half in arm.halves]
    drifts = arm.share[None] * _drift(arm.halves, changes, arm.wide, limit)

    def cost(half: _Half, changes: list[list[Array]], drift: Array) -> Array:
        total = jnp.zeros_like(drift)
        for change, step, there in zip(changes, half.steps, half.there, strict=True):
            rest = [colour - step * drift for colour in change]
            total = total + there * truncated(rest, truncation)
        count = jnp.sum(half.there)
        # A half without views confirms nothing.
        return jnp.where(count > 0, total / jnp.maximum(count, 1), 1)

    means = jnp.stack([cost(*of) for of in zip(arm.halves, changes, unstack(drifts), strict=True)])
    first, second = unstack(weighted_sum(means, arm.support))
    return _better(first, second, alpha)


def _better(first: Array, second: Array, alpha: Array) -> Array:
    """The smaller of two costs; under noise softly, for the least of two is biased."""
    scale = 0.05 * jnp.where(alpha > 0, alpha, 1)

    def soft(first: Array, second: Array) -> Array:
        return jnp.minimum(first, second) - scale * jnp.log(
            0.5 * (1 + jnp.exp(-jnp.abs(first - second) / scale))
        )

    return lax.cond(alpha > 0, soft, jnp.minimum, first, second)


def _drift(
    halves: tuple[_Half, _Half], changes: list[list[list[Array]]], weights: Array, limit: Array
) -> Float[Array, "h y x"]:
    """Change of the grey of a window per view step, by regression through the centre view."""
    ends = [jnp.max(jnp.abs(half.steps), initial=1) for half in halves]

    def trend(half: _Half, changes: list[list[Array]], last: Array) -> Array:
        total, square = jnp.zeros_like(weights[0]), jnp.zeros_like(last)
        for change, step, there in zip(changes, half.steps, half.there, strict=True):
            gray = sum(change[1:], change[0]) / len(change)
            # What is far beyond any drift is another surface, and says nothing about this one.
            total = total + there * step * jnp.clip(gray, -3 * limit, 3 * limit)
            square = square + there * step**2
        return total * (last / jnp.maximum(square, 1))

    trends = jnp.stack([trend(*of) for of in zip(halves, changes, ends, strict=True)])
    change = weighted_sum(trends, weights, spacing=2)
    return jnp.clip(change, -limit, limit) / jnp.stack(ends)[:, None, None]


def truncated(change: list[Array], truncation: Array) -> Array:
    # Colours are summed by hand: XLA on CPU does not vectorise a sum over a leading axis.
    square = change[0] ** 2
    for colour in change[1:]:
        square = square + colour**2
    return square / (square + truncation)


def _halves(arm: Arm) -> tuple[_Half, _Half]:
    width = arm.planes.shape[3]
    indices = sweep_views(arm.planes.shape[0])

    def half(views: list[int]) -> _Half:
        chosen = np.asarray(views, int)
        padding = ((0, 0), (0, 0), (0, 0), (width, width + 3))
        planes = jnp.pad(arm.planes[chosen], padding, mode="edge")
        return _Half(planes, arm.steps[chosen], arm.available[chosen].astype(planes.dtype))

    before = half([i for i in indices if i < arm.centre])
    return before, half([i for i in indices if i > arm.centre])


def _changes(half: _Half, centre: Array, disparity: Array) -> list[list[Array]]:
    """Colours of every view of a half at a disparity, less those of the centre view."""
    width = centre.shape[2]
    result = []
    for planes, step in zip(unstack(half.planes), half.steps, strict=True):
        shift = step * disparity
        whole = jnp.floor(shift)
        weights = keys_taps(shift - whole)
        first = jnp.clip(whole.astype(jnp.int32), -width, width) + width - 1
        part = lax.dynamic_slice_in_dim(planes, first, width + 3, axis=2)
        taps = [unstack(part[:, :, j : j + width]) for j in range(4)]
        result.append(
            [
                sum((weights[j] * taps[j][c] for j in range(1, 4)), weights[0] * taps[0][c])
                - reference
                for c, reference in enumerate(unstack(centre))
            ]
        )
    return result


def cheapest(total: Float[Array, "d y x"], disparities: Float[Array, " d"]) -> Array:
    """The disparity of least cost, refined by a parabola through it and its neighbours."""
    count = disparities.shape[0]
    winner = jnp.argmin(total, axis=0)[None]
    inner = jnp.clip(winner, 1, max(count - 2, 1))

    def at(index: Array) -> Array:
        return jnp.take_along_axis(total, jnp.clip(index, 0, count - 1), axis=0)[0]

    before, here, after = at(inner - 1), at(inner), at(inner + 1)
    shift = jnp.clip(vertex(before, here, after), -0.5, 0.5)
    shift = jnp.where((winner == inner)[0], shift, 0)
    spacing = (disparities[-1] - disparities[0]) / (count - 1)
    return disparities[winner[0]] + spacing * shift


def sweep_views(count: int) -> tuple[int, ...]:
    """Views of an arm that a sweep looks at: the ends and half of the way to them."""
    centre = count // 2
    near = centre // 2
    picked = {0, centre - near, centre + near, count - 1} - {centre}
    return tuple(sorted(picked))
