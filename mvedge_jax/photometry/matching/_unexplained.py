"""Residual variance of the best disparity between views: an upper bound of the noise."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._cpu import plane_sum
from mvedge_jax._crosshair import Arm, Crosshair
from mvedge_jax.image import window_sum
from mvedge_jax.interpolation import cubic_taps, spline_coefficients, spline_noise

from ..views import ViewSet
from ._arm import Half, halves_of, shifted
from ._stack import better_half, linear

# One of this many rows is sampled, for speed.
_ROWS = 8


def between_views_variance(
    views: Crosshair | ViewSet, disparities: Float[Array, " d"], *, finer: int = 1
) -> Float[Array, ""]:
    """Residual variance of a channel at the best disparity, over the half that agrees.

    Every eighth row is sampled, in windows of 7 px. Differences of interpolated views are
    normalized by the noise that remains after the interpolation.

    Args:
        views: views after exposure and gains; of a crosshair, the longer arm is read.
        disparities: hypotheses, px per view step, evenly spaced.
        finer: number of disparities tried per hypothesis of a crosshair, so that the error of a
            hypothesis does not look like noise.

    Returns:
        The 20 % quantile over the windows; 0 if the reference shows nothing. Differentiable.
    """
    if isinstance(views, ViewSet):
        unexplained, center = _of_stack(views), views.center
    else:
        arm = max(views, key=lambda arm: arm.planes.shape[0])
        unexplained, center = _of_arm(arm), arm.planes[arm.center]
        count = finer * (disparities.shape[0] - 1) + 1
        disparities = jnp.linspace(disparities[0], disparities[-1], count)
    rows = center[0, ::_ROWS]

    def consider(best: Array, disparity: Array) -> tuple[Array, None]:
        return jnp.minimum(best, unexplained(disparity)), None

    best, _ = lax.scan(jax.checkpoint(consider), jnp.full_like(rows, jnp.inf), disparities)
    if not isinstance(views, ViewSet) or views.shown is None:
        return jnp.sort(best.reshape(-1))[best.size // 5]
    # Transparent pixels have one color in all views: their windows are ignored.
    whole = window_sum(views.shown[0, ::_ROWS], 3, 1) > 6.5
    ordered = jnp.sort(jnp.where(whole, best, jnp.inf).reshape(-1))
    fifth = ordered[(jnp.sum(whole) // 5).astype(jnp.int32)]
    return jnp.where(jnp.any(whole), fifth, 0)


def _of_arm(arm: Arm) -> Callable[[Array], Array]:
    """Mean square, by disparity, of the half of an arm that agrees better."""
    rows = arm._replace(planes=arm.planes[:, :, ::_ROWS])
    center = rows.planes[rows.center]
    # Splines: of the contrast of a texture of .4 periods per px, which would pass for noise, Keys'
    # taps lose more than a half between pixels, splines a third.
    halves = halves_of(rows._replace(planes=spline_coefficients(rows.planes, axis=-1)))

    def of_half(half: Half, disparity: Array) -> Array:
        total, width = jnp.zeros_like(center[0]), center.shape[2]
        moved = shifted(half, disparity, (0, 0), (center.shape[1], width))
        for part, step, there in zip(moved, half.steps, half.there, strict=True):
            weights, _ = cubic_taps(step * disparity - jnp.floor(step * disparity))
            seen = sum(w * part[..., j : j + width] for j, w in enumerate(weights))
            kept = 1 + spline_noise(weights)
            total = total + there / (center.shape[0] * kept) * plane_sum((seen - center) ** 2)
        count = jnp.sum(half.there)
        total = jnp.where(count > 0, total / jnp.maximum(count, 1), jnp.inf)
        return window_sum(total, 3, 1) / 7

    return lambda disparity: jnp.minimum(*(of_half(half, disparity) for half in halves))


def _of_stack(views: ViewSet) -> Callable[[Array], Array]:
    """Mean square, by disparity, of the half of the views that agrees better."""
    shape, rows = views.planes.shape[2:], views.center[:, ::_ROWS]
    others = views.mapped(lambda planes: jnp.moveaxis(planes, 1, -1)).others

    def unexplained(disparity: Array) -> Array:
        def one(view: ViewSet) -> Array:
            positions = view.parallax.positions(jnp.full(shape, disparity))
            x, y = (p[::_ROWS] for p in positions)
            # Interpolation averages noise, most between four pixels.
            kept = jnp.ones_like(x)
            for place in (x, y):
                part = place - jnp.floor(place)
                kept = kept * (part**2 + (1 - part) ** 2)
            square = [(v - r) ** 2 for v, r in zip(linear(view.planes, x, y), rows, strict=True)]
            mean = sum(square[1:], square[0]) / len(square)
            there = view.readable(x, y, shape, None)
            return window_sum(jnp.where(there, mean / (1 + kept), 1), 3, 1) / 7

        return better_half(lax.map(one, others))

    return unexplained
