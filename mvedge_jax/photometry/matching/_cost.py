"""Hypotheses: per pixel, the disparity whose views agree best, whatever hides some of them."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._crosshair import Crosshair
from mvedge_jax._params import at_least, cast, number
from mvedge_jax._recomputed import kept
from mvedge_jax.interpolation import vertex

from .._window import colour_weights, contrast
from ..brightness._noise import Noise
from ..views import ViewSet
from ._arm import Limits, swept
from ._paths import aggregate
from ._pooling import Pooling, pooled
from ._stack import stack_costs
from ._volume import Sweep, volume


class Matching(eqx.Module):
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
        jump_color: step of color that halves the price of a jump.
        same_color: neighbors whose color differs by much more than this take no part in a window.
        outline: gradient near which half of the drift is granted, and soon none: beside an outline,
            a change of mean color is what shows the wrong hypothesis.
        least_noise: least standard deviation of the noise that is assumed.
        pooling: of the costs along surfaces, where noise rules.
        outline_reach: how far gradients are looked for, px: the reach of a window and of its drift.
    """

    truncation: Float[Array, ""] = number(4.0, "noise variances")
    drift: Float[Array, ""] = number(1.5 / 255, "sRGB")
    slant: Float[Array, ""] = number(0.05, "of a cost of at most 2")
    jump: Float[Array, ""] = number(0.8, "of a cost of at most 2")
    jump_color: Float[Array, ""] = number(4.0, "CIELAB")
    same_color: Float[Array, ""] = number(4.0, "CIELAB")
    outline: Float[Array, ""] = number(2.0, "CIELAB/px")
    least_noise: Float[Array, ""] = number(1 / 255, "sRGB")
    pooling: Pooling = eqx.field(default_factory=Pooling)
    outline_reach: int = eqx.field(static=True, default=5)

    def __check_init__(self) -> None:
        at_least(self, outline_reach=1)


@partial(jax.jit, static_argnames="window")
def hypotheses(
    views: Crosshair | ViewSet,
    lab: Float[Array, "c y x"],
    disparities: Float[Array, " d"],
    params: Matching,
    *,
    window: int,
    noise: Noise | None = None,
) -> Float[Array, "y x"]:
    r"""Per pixel, the disparity at which the views agree best.

    A pixel beside a nearer surface is hidden in the views of one side of each arm. Of each
    arm, therefore, only the half that agrees better counts:
    $\min(C_{left}, C_{right}) + \min(C_{above}, C_{below})$, each a mean of truncated
    squared colour differences to the centre view over a colour-weighted window. Of a `ViewSet`,
    whose views have no sides, the better half of all of them counts, twice.

    On glossy and on dark surfaces the colour of a window drifts from view to view, at the true
    disparity by more than its texture differs at a wrong one. Away from outlines, what such a
    window changes in proportion to the view step is therefore taken out, per half, up to a limit.

    These costs are summed along paths through the image, so that pixels that the views say little
    about follow their surroundings; see `aggregate`. Noise makes jumps cheaper, softens the choice
    of the half, and has costs pooled along surfaces first.

    Args:
        views: low-passed as the noise asks.
        lab: the centre view in CIELAB, denoised, `[c, y, x]`.
        disparities: what to try, px per view step, increasing, evenly spaced.
        params: see `Matching`.
        window: half the width of the window, px.
        noise: of the views before any low-pass; None for none.

    Returns:
        Disparity per pixel, between the hypotheses by a parabola. Differentiable in all but
        `disparities`' number, at the hypothesis chosen.
    """
    params = cast(params, lab.dtype)
    noise = Noise.of(jnp.zeros((), lab.dtype)) if noise is None else noise
    costs = kept(_costs(views, lab, disparities, params, noise, window))
    return cheapest(along_paths(costs, lab, noise, params), disparities)


@partial(jax.jit, static_argnames="window")
def best_match(
    views: Crosshair | ViewSet,
    lab: Float[Array, "c y x"],
    disparities: Float[Array, " d"],
    params: Matching,
    *,
    window: int,
    noise: Noise | None = None,
) -> tuple[Float[Array, "y x"], Float[Array, "y x"]]:
    """The cheapest hypothesis of every pixel by itself: `hypotheses` without paths and pooling.

    Args:
        views: exposure and gains taken out.
        lab: the centre view in CIELAB, `[c, y, x]`.
        disparities: what to try, px per view step, increasing, evenly spaced.
        params: see `Matching`.
        window: half the width of the window, px.
        noise: of the views; None for none.

    Returns:
        Disparity and its cost per pixel: 0 where the better halves of both arms agree, 2 where no
        view does. Differentiable as `hypotheses`.
    """
    params = cast(params, lab.dtype)
    noise = Noise.of(jnp.zeros((), lab.dtype)) if noise is None else noise
    total = _costs(views, lab, disparities, params, noise, window)
    return cheapest(total, disparities), jnp.min(total, axis=0)


def _costs(
    views: Crosshair | ViewSet,
    lab: Array,
    disparities: Array,
    params: Matching,
    noise: Noise,
    window: int,
) -> Float[Array, "d y x"]:
    """The cost of every disparity at every pixel."""
    truncation = params.truncation * views.centre.shape[0] * noise_variance(noise, params)
    limits = Limits(truncation, params.drift, noise.alpha)
    share, alike = shared_drift(noise, lab, params), params.same_color
    if isinstance(views, ViewSet):
        support, wide = (colour_weights(lab, alike, reach=window, spacing=s) for s in (1, 2))
        return stack_costs(views, disparities, (support, wide), share, limits)
    across = swept(views.horizontal, lab, share, alike, window)
    down = swept(views.vertical, jnp.swapaxes(lab, 1, 2), share.T, alike, window)
    return volume(window, Sweep(across, down, disparities, limits))


def along_paths(
    costs: Float[Array, "d y x"], lab: Float[Array, "c y x"], noise: Noise, params: Matching
) -> Float[Array, "d y x"]:
    """Costs pooled along surfaces and summed along paths; noise makes jumps cheaper."""
    cheaper = 1 - 0.75 * noise.alpha
    return aggregate(
        pooled(costs, lab, noise, params.pooling),
        lab,
        slant=cheaper * params.slant,
        jump=cheaper * params.jump,
        colour=params.jump_color,
    )


def noise_variance(noise: Noise, params: Matching) -> Float[Array, ""]:
    """What truncated differences are measured by."""
    # Of views without noise, two thirds of what was measured: texture is in it.
    deviation = noise.deviation * (noise.alpha + (1 - noise.alpha) / 1.45)
    return jnp.maximum(deviation, params.least_noise) ** 2


def shared_drift(noise: Noise, lab: Float[Array, "c y x"], params: Matching) -> Float[Array, "y x"]:
    """How much of a window's drift is granted at every pixel, 0..1."""
    steepest = contrast(lab, radius=params.outline_reach)
    return (1 - noise.alpha) / (1 + (steepest / params.outline) ** 4)


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
