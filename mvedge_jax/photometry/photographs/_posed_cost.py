"""Hypotheses from posed photographs: per pixel, the disparity at which the better half agrees."""

from functools import partial

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._cpu import plane_sum
from mvedge_jax._params import cast
from mvedge_jax._root import root
from mvedge_jax.image import window_sum

from .._places import Projection, shown_at
from .._window import colour_weights, weighted_sum
from ..brightness._noise import Noise
from ..matching._arm import truncated
from ..matching._cost import Matching, along_paths, cheapest, noise_variance, shared_drift

# Of so many rows, one is looked at for the noise: its sample, for speed.
_ROWS = 8


@partial(jax.jit, static_argnames=("window", "paths"))
def posed_hypotheses(
    images: Float[Array, "s c y x"],
    places: Projection,
    available: Bool[Array, " s"],
    lab: Float[Array, "c y x"],
    disparities: Float[Array, " d"],
    params: Matching,
    *,
    noise: Noise,
    window: int,
    paths: bool = True,
    shown: Float[Array, "s y x"] | None = None,
) -> Float[Array, "y x"]:
    r"""Per pixel of the first photograph, the disparity at which the others agree best.

    What hides a pixel hides it from one side, as a rule, so that of all photographs only the better
    half counts: its mean of truncated squared colour differences over a colour-weighted window. Of
    each, a change of the window's mean colour within limits is taken out first, away from outlines:
    gloss, shading, and exposures that are not quite alike. A photograph in whose frame a pixel is
    not, or behind whose camera, confirms nothing.

    Args:
        images: low-passed, gains taken out; the reference first.
        places: where each of them shows the reference's pixels.
        available: those that are to be read.
        lab: the reference in CIELAB, denoised, `[c, y, x]`.
        disparities: what to try, increasing, evenly spaced.
        params: see `Matching`.
        noise: of the images before any low-pass.
        window: half the width of the window, px.
        paths: sum costs along paths through the image, see `hypotheses`; without, every pixel has
            the hypothesis that is cheapest for it.
        shown: 1 where a photograph shows the scene, 0 where it is transparent, which confirms
            nothing; None for everywhere.

    Returns:
        Disparity per pixel, between the hypotheses by a parabola. Differentiable as `hypotheses`.
    """
    params = cast(params, lab.dtype)
    (height, width), reference, count = lab.shape[1:], images[0], images.shape[0] - 1
    truncation = params.truncation * images.shape[1] * noise_variance(noise, params)
    share = shared_drift(noise, lab, params)
    alike = params.same_color
    support, wide = (colour_weights(lab, alike, reach=window, spacing=s) for s in (1, 2))
    apart = root(jnp.sum(places.epipole[1:] ** 2, axis=1))
    limits = params.drift * apart / jnp.max(apart)
    others = (
        jnp.moveaxis(images[1:], 1, -1),
        Projection(places.homography[1:], places.epipole[1:]),
        available[1:],
        limits,
        None if shown is None else shown[1:],
    )

    @jax.checkpoint
    def cost(disparity: Array) -> Array:
        everywhere = jnp.full((height, width), disparity)

        def one(view: tuple[Array, Projection, Array, Array, Array | None]) -> Array:
            image, place, there, limit, opaque = view
            x, y = place.positions(everywhere)
            inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1) & there
            if shown is not None and opaque is not None:
                inside = inside & shown_at(opaque, x, y) & (shown[0] > 0)
            change = jnp.stack(_linear(image, x, y)) - reference
            gray = plane_sum(change) / change.shape[0]
            # What is far beyond any drift is another surface, and says nothing about this one.
            gray = jnp.where(inside, jnp.clip(gray, -3 * limit, 3 * limit), 0)
            drift = weighted_sum(gray[None], wide, spacing=2)[0]
            drift = share * jnp.clip(drift, -limit, limit)
            return jnp.where(inside, truncated(change - drift[None], truncation), 1)

        return 2 * _better_half(weighted_sum(lax.map(one, others), support), count)

    total = lax.map(cost, disparities)
    if paths:
        total = along_paths(total, lab, noise, params)
    return cheapest(total, disparities)


def posed_variance(
    images: Float[Array, "s c y x"],
    places: Projection,
    available: Bool[Array, " s"],
    disparities: Float[Array, " d"],
    shown: Float[Array, "s y x"] | None = None,
) -> Float[Array, ""]:
    """Variance of a channel that the best disparity of the better half leaves unexplained.

    `between_views_variance`, for photographs: of every eighth row, over windows of 7 px.

    Args:
        images: gains taken out, the reference first.
        places: where each of them shows the reference's pixels.
        available: those that are to be read.
        disparities: what to try.
        shown: see `posed_hypotheses`.

    Returns:
        What a fifth of the windows stay below. Differentiable.
    """
    height, width = images.shape[2:]
    rows = images[0, :, ::_ROWS]
    others = (
        jnp.moveaxis(images[1:], 1, -1),
        Projection(places.homography[1:], places.epipole[1:]),
        available[1:],
    )

    @jax.checkpoint
    def unexplained(best: Array, disparity: Array) -> tuple[Array, None]:
        everywhere = jnp.full((height, width), disparity)

        def one(view: tuple[Array, Projection, Array]) -> Array:
            image, place, there = view
            x, y = (p[::_ROWS] for p in place.positions(everywhere))
            inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1) & there
            # Interpolation averages noise away, most between four pixels.
            kept = jnp.ones_like(x)
            for place_of in (x, y):
                part = place_of - jnp.floor(place_of)
                kept = kept * (part**2 + (1 - part) ** 2)
            square = [(v - r) ** 2 for v, r in zip(_linear(image, x, y), rows, strict=True)]
            mean = sum(square[1:], square[0]) / len(square)
            return window_sum(jnp.where(inside, mean / (1 + kept), 1), 3, 1) / 7

        found = _better_half(lax.map(one, others), images.shape[0] - 1)
        return jnp.minimum(best, found), None

    best, _ = lax.scan(unexplained, jnp.full_like(rows[0], jnp.inf), disparities)
    if shown is None:
        ordered = jnp.sort(best.reshape(-1))
        return ordered[int(0.2 * ordered.shape[0])]
    # Of what is transparent, all photographs are the same color: its windows have no say.
    whole = window_sum(shown[0, ::_ROWS], 3, 1) > 6.5
    ordered = jnp.sort(jnp.where(whole, best, jnp.inf).reshape(-1))
    fifth = ordered[(jnp.sum(whole) // 5).astype(jnp.int32)]
    return jnp.where(jnp.any(whole), fifth, 0)


def _better_half(costs: Float[Array, "s y x"], count: int) -> Float[Array, "y x"]:
    """Mean of the smaller half of the costs, by exchanges: XLA on CPU vectorises these, no sort."""
    planes = [costs[i] for i in range(count)]
    kept = (count + 1) // 2
    for first in range(kept):
        for other in range(first + 1, count):
            low = jnp.minimum(planes[first], planes[other])
            planes[other] = jnp.maximum(planes[first], planes[other])
            planes[first] = low
    return sum(planes[1:kept], planes[0]) / kept


def _linear(image: Float[Array, "y x c"], x: Array, y: Array) -> list[Array]:
    """Colours between pixels, by linear interpolation; the border is repeated."""
    height, width, channels = image.shape
    x, y = jnp.clip(x, 0, width - 1), jnp.clip(y, 0, height - 1)
    column = jnp.minimum(jnp.floor(x), width - 2).astype(jnp.int32)
    row = jnp.minimum(jnp.floor(y), height - 2).astype(jnp.int32)
    right, down = x - column.astype(x.dtype), y - row.astype(y.dtype)
    first = (row * width + column) * channels
    # Both pixels of a row and their channels lie side by side: one gather for all of them.
    slices = lax.GatherDimensionNumbers(
        offset_dims=(2,), collapsed_slice_dims=(), start_index_map=(0,)
    )
    flat, result = image.reshape(-1), []
    upper, lower = (
        lax.gather(flat, start[..., None], slices, (2 * channels,), mode="promise_in_bounds")
        for start in (first, first + width * channels)
    )
    for c in range(channels):
        above = upper[..., c] + right * (upper[..., c + channels] - upper[..., c])
        below = lower[..., c] + right * (lower[..., c + channels] - lower[..., c])
        result.append(above + down * (below - above))
    return result
