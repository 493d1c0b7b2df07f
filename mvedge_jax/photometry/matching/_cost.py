"""Hypotheses: per pixel, the disparity at which the visible views agree best."""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._checkpoint import save_residual
from mvedge_jax._crosshair import Crosshair
from mvedge_jax._params import at_least, cast, number
from mvedge_jax.interpolation import vertex

from .._window import color_weights, contrast
from ..brightness._noise import Noise
from ..views import ViewSet
from ._agreement import Agreement
from ._arm import Limits, swept
from ._paths import aggregate
from ._pooling import Pooling, pooled
from ._stack import stack_costs
from ._volume import Sweep, volume


class Matching(eqx.Module):
    """Parameters of the hypotheses.

    Attributes:
        truncation: squared color differences saturate at this many times the scene's noise, so
            that a view in which the pixel is hidden does not dominate.
        drift: allowed change of a window's mean color, sRGB, from the center view to the last one,
            by gloss and shading. It falls with the dominance of noise, which looks like drift.
        slant: penalty of a change by one hypothesis between neighboring pixels; costs are at most
            2.
        jump: penalty of a larger change between pixels of the same color.
        jump_color: step of color that halves the penalty of a jump.
        same_color: difference of color at which a neighbor's weight in a window is 1/e.
        outline: gradient nearby at which half of the drift is allowed, because a wrong hypothesis
            beside an outline shows as a change of mean color.
        least_noise: lower bound of the noise's standard deviation.
        pooling: pooling of the costs along surfaces in noisy views.
        temperature: difference of summed costs at which a rival hypothesis is 1/e as likely as the
            best one.
        agreement: costs of photographs at any positions; None for those of a light field's views.
        outline_reach: radius in which gradients count, px: that of a window and of its drift.
        reach: hypotheses of the largest step between neighboring pixels that is priced by `slant`,
            in proportion to its size, where that is less than `jump`.
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
    temperature: Float[Array, ""] = number(0.2, "of a cost of at most 8")
    agreement: Agreement | None = None
    outline_reach: int = eqx.field(static=True, default=5)
    reach: int = eqx.field(static=True, default=1)

    def __check_init__(self) -> None:
        at_least(self, outline_reach=1, reach=1)


class Hypotheses(NamedTuple):
    """The best hypothesis of every pixel, and the moments of the posterior over all of them.

    Attributes:
        disparity: the best hypothesis, px per view step, `[y, x]`.
        mean: mean of the posterior, `[y, x]`.
        variance: variance of the posterior, px², `[y, x]`; large where rivals are as likely.
    """

    disparity: Float[Array, "y x"]
    mean: Float[Array, "y x"]
    variance: Float[Array, "y x"]

    def variance_around(self, disparity: Float[Array, "y x"]) -> Float[Array, "y x"]:
        """Second moment of the posterior around a map, px², `[y, x]`. Differentiable."""
        return self.variance + (disparity - self.mean) ** 2


@partial(jax.jit, static_argnames="window")
def hypotheses(
    views: Crosshair | ViewSet,
    lab: Float[Array, "c y x"],
    disparities: Float[Array, " d"],
    params: Matching,
    *,
    window: int,
    noise: Noise | None = None,
) -> Hypotheses:
    r"""Per pixel, the disparity at which the views agree best, and the posterior over all.

    A pixel beside a nearer surface is hidden in the views of one side of each arm. So only the
    half of each arm that agrees better counts:
    $\min(C_{left}, C_{right}) + \min(C_{above}, C_{below})$, each a mean of truncated
    squared color differences to the center view over a color-weighted window. The views of a
    `ViewSet` have no sides: the better half of all of them counts, twice.

    On glossy and on dark surfaces the color of a window drifts from view to view, by more than its
    texture differs at a wrong disparity. Away from outlines, the change of a window in proportion
    to the view step is therefore removed, per half, up to a limit.

    These costs are summed along paths through the image, so that pixels with little texture follow
    their surroundings; see `aggregate`. Noise makes jumps cheaper, softens the choice of the half,
    and pools costs along surfaces first. With the sums $C_d$ as energies, a hypothesis has the
    posterior probability $p_d \propto e^{-C_d / T}$.

    Args:
        views: views, low-passed according to the noise.
        lab: the center view in CIELAB, denoised, `[c, y, x]`.
        disparities: what to try, px per view step, increasing, evenly spaced.
        params: see `Matching`.
        window: half the width of the window, px.
        noise: noise of the views before any low-pass; None for none.

    Returns:
        Disparity per pixel, between the hypotheses by a parabola, and moments of the posterior.
        Differentiable in all but `disparities`' number, at the hypothesis chosen.
    """
    params = cast(params, lab.dtype)
    noise = Noise.of(jnp.zeros((), lab.dtype)) if noise is None else noise
    costs = save_residual(_costs(views, lab, disparities, params, noise, window))
    total = along_paths(costs, lab, noise, params)
    moments = _moments(total, disparities, params.temperature)
    return Hypotheses(cheapest(total, disparities), *moments)


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
    """The hypothesis of least cost at every pixel: `hypotheses` without paths and pooling.

    Args:
        views: views after exposure and gains.
        lab: the center view in CIELAB, `[c, y, x]`.
        disparities: what to try, px per view step, increasing, evenly spaced.
        params: see `Matching`.
        window: half the width of the window, px.
        noise: noise of the views; None for none.

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
    variance = noise_variance(noise, params)
    truncation = params.truncation * views.center.shape[0] * variance
    limits = Limits(truncation, params.drift, noise.alpha)
    share, alike = shared_drift(noise, lab, params), params.same_color
    if isinstance(views, ViewSet):
        support, wide = (color_weights(lab, alike, reach=window, spacing=s) for s in (1, 2))
        of = (support, wide), share, limits, variance, params.agreement
        return stack_costs(views, disparities, *of)
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
        color=params.jump_color,
        reach=params.reach,
    )


def noise_variance(noise: Noise, params: Matching) -> Float[Array, ""]:
    """Unit of the truncated differences."""
    # Two thirds of the estimate for views without noise, because it includes texture.
    deviation = noise.deviation * (noise.alpha + (1 - noise.alpha) / 1.45)
    return jnp.maximum(deviation, params.least_noise) ** 2


def shared_drift(noise: Noise, lab: Float[Array, "c y x"], params: Matching) -> Float[Array, "y x"]:
    """Share of a window's drift that is allowed at every pixel, 0..1."""
    steepest = contrast(lab, radius=params.outline_reach)
    return (1 - noise.alpha) / (1 + (steepest / params.outline) ** 4)


def _moments(
    total: Float[Array, "d y x"], disparities: Float[Array, " d"], temperature: Float[Array, ""]
) -> tuple[Float[Array, "y x"], Float[Array, "y x"]]:
    """Mean and variance of the posterior over the hypotheses."""
    least = lax.stop_gradient(jnp.min(total, axis=0))  # a common factor, which keeps floats finite
    middle = 0.5 * (disparities[0] + disparities[-1])

    # A loop over planes, which XLA on CPU vectorizes, unlike a sum over the first axis.
    @jax.checkpoint
    def add(sums: tuple[Array, Array, Array], one: tuple[Array, Array]) -> tuple[Any, None]:
        cost, disparity = one
        likely, place = jnp.exp((least - cost) / temperature), disparity - middle
        powers = likely, likely * place, likely * place**2
        return jax.tree.map(jnp.add, sums, powers), None

    nothing = jnp.zeros_like(least)
    (likely, first, second), _ = lax.scan(add, (nothing,) * 3, (total, disparities))
    mean = first / likely
    return middle + mean, jnp.maximum(second / likely - mean**2, 0)


def cheapest(total: Float[Array, "d y x"], disparities: Float[Array, " d"]) -> Array:
    """The disparity of least cost, refined by a parabola through it and its neighbors."""
    count = disparities.shape[0]
    winner = jnp.argmin(total, axis=0)[None]
    inner = jnp.clip(winner, 1, max(count - 2, 1))

    def at(index: Array) -> Array:
        places = jnp.clip(index, 0, count - 1)
        return jnp.take_along_axis(total, places, axis=0, mode="promise_in_bounds")[0]

    before, here, after = at(inner - 1), at(inner), at(inner + 1)
    shift = jnp.clip(vertex(before, here, after), -0.5, 0.5)
    shift = jnp.where((winner == inner)[0], shift, 0)
    spacing = (disparities[-1] - disparities[0]) / (count - 1)
    return disparities[winner[0]] + spacing * shift
