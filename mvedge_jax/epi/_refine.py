"""Refinement of disparities by photo-consistency, to a few thousandths of a pixel."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ._spline import spline_slope, spline_weight

# Interpolation weights per row: four would do for a fixed position, six leave it room to move by
# one pixel in the outermost views without another gather.
_TAPS = 6
_LOW = (_TAPS - 2) // 2
_SLACK = 0.95


class Refined(NamedTuple):
    """What is known of each point after the refinement.

    Attributes:
        disparity: px per view step.
        information: curvature of the objective, summed over views and the effective number of
            pixels, grey levels squared.
        residual: mean squared residual over views and the whole window.
        contrast: mean squared slope over the window, of the arm where it is larger.
        core_contrast: `contrast` over the inner 3x3 pixels.
        view_residual: `core_residual` per view, vertical arm first.
        mismatch: residual relative to the contrast on the best half (left, right, upper or lower,
            centre line included) of the inner 3x3 pixels: at a depth edge the other half shows
            another surface.
        inside: which views show the whole of the window that the centre view shows.
    """

    disparity: Float[Array, " n"]
    information: Float[Array, " n"]
    residual: Float[Array, " n"]
    contrast: Float[Array, " n"]
    core_contrast: Float[Array, " n"]
    view_residual: Float[Array, "s n"]
    mismatch: Float[Array, " n"]
    inside: Bool[Array, "s n"]


def refinement_reach(views: int) -> float:
    """How far the refinement can move a disparity, px per view step."""
    return _SLACK / max(views // 2, 1)


def no_points(count: int, views: int, dtype: jnp.dtype) -> Refined:
    """All zeros."""
    nothing = jnp.zeros(count, dtype)
    per_view = jnp.zeros((views, count), dtype)
    inside = jnp.zeros((views, count), bool)
    return Refined(nothing, nothing, nothing, nothing, nothing, per_view, nothing, inside)


def _strips(
    coefficients: Array, row: Array, column: Array, disparity: Array, half: int
) -> tuple[Array, Array, Array, Array]:
    """Gathers the coefficients that the windows of all points can need: [view, row, offset, n]."""
    views, height, width = coefficients.shape
    steps = jnp.asarray(views // 2 - np.arange(views), disparity.dtype)
    position = column[None].astype(disparity.dtype) + steps[:, None] * disparity[None]
    base = jnp.floor(lax.stop_gradient(position))
    start = base.astype(jnp.int32) - half - _LOW
    rows = jnp.clip(
        row[None] + jnp.arange(-half, half + 1, dtype=jnp.int32)[:, None], 0, height - 1
    )
    length = 2 * half + _TAPS
    columns = jnp.clip(
        start[:, None] + jnp.arange(length, dtype=jnp.int32)[None, :, None], 0, width - 1
    )
    flat = jnp.arange(views, dtype=jnp.int32)[:, None, None, None] * height + rows[None, :, None]
    flat = flat * width + columns[:, None]
    strips = coefficients.reshape(-1).at[flat].get(mode="promise_in_bounds")
    low = jnp.minimum(column, half)[None].astype(position.dtype) - 0.5
    high = jnp.maximum(column, width - 1 - half)[None].astype(position.dtype) + 0.5
    inside = (position >= low) & (position <= high)
    return strips, steps, base, inside


def _sample(
    strips: Array, steps: Array, base: Array, column: Array, disparity: Array, half: int
) -> tuple[Array, Array]:
    """Values and slopes of all windows: [view, row, column, n]."""
    shift = column[None].astype(base.dtype) + steps[:, None] * disparity[None] - base
    offset = jnp.arange(_TAPS, dtype=base.dtype)[None, :, None] - _LOW - shift[:, None]
    weight, slope = spline_weight(offset), -spline_slope(offset)
    side = 2 * half + 1

    def apply(taps: Array) -> Array:
        terms = [taps[:, q, None, None] * strips[:, :, q : q + side] for q in range(_TAPS)]
        return sum(terms[1:], terms[0])

    return apply(weight), apply(slope)


def refine_points(
    coefficients: tuple[Float[Array, "u y x"], Float[Array, "v x y"]],
    column: Int[Array, " n"],
    row: Int[Array, " n"],
    disparity: Float[Array, " n"],
    start: Float[Array, "s n"],
    robustness: Float[Array, ""],
    saturation: Float[Array, ""],
    contrast_floor: Float[Array, ""],
    anchored: Bool[Array, ""],
    *,
    window: int,
    iterations: int,
) -> Refined:
    """Gauss-Newton on the variance of windows along the lines of points, both arms together.

    The residual of a view is its window less the weighted mean over all views; its derivative is
    the view step times the mean slope over the views of its arm. (The slope of the single view
    would correlate with that view's noise and bias the step.) Views that disagree lose weight.

    Args:
        coefficients: B-spline coefficients, along the arm, of the grey views of the horizontal
            and of the vertical arm, the latter with x and y swapped.
        column: pixel of each point.
        row: pixel of each point.
        disparity: start, within a quarter of a pixel or so.
        start: initial weight of each view, vertical arm first.
        robustness: residual, relative to the contrast of the window, at which a view has a
            quarter of its weight.
        saturation: variance over the views at which a pixel of the window has a quarter of its
            weight.
        contrast_floor: added to the contrast where residuals are compared with it.
        anchored: take the centre view for what the point looks like, so that views that are
            hidden lose their weight from the first step on, and judge the point by the views
            that are left. Their loss costs: the residuals grow by the share of weight lost.
        window: side of the window, odd.
        iterations: Gauss-Newton steps.

    Returns:
        Disparities and how far to trust them. Differentiable (unrolled) in the coefficients, the
        starting disparity and the parameters.

    Source: REFERENCE_NOTES section 24; it takes the place of the entropy search of Thesis 4.1.5.
    """
    half = window // 2
    across, down = coefficients
    strips_h, steps_h, base_h, inside_h = _strips(across, row, column, disparity, half)
    strips_v, steps_v, base_v, inside_v = _strips(down, column, row, disparity, half)
    inside = jnp.concatenate([inside_v, inside_h])
    known = inside.astype(disparity.dtype) * start
    nothing_h, nothing_v = jnp.zeros_like(steps_h), jnp.zeros_like(steps_v)
    # View steps in x and y, vertical arm first.
    step_x = jnp.concatenate([nothing_v, steps_h])[:, None]
    step_y = jnp.concatenate([steps_v, nothing_h])[:, None]
    count_v = steps_v.shape[0]
    limit = refinement_reach(max(down.shape[0], across.shape[0]))
    core = slice(max(half - 1, 0), half + 2)

    def measure(current: Array, weight: Array) -> tuple[Array, Refined]:
        values_h, slopes_h = _sample(strips_h, steps_h, base_h, column, current, half)
        values_v, slopes_v = _sample(strips_v, steps_v, base_v, row, current, half)
        values = jnp.concatenate([jnp.swapaxes(values_v, 1, 2), values_h])
        share = weight / jnp.maximum(weight.sum(0), 1e-6)[None]
        residual = values - (share[:, None, None] * values).sum(0)[None]

        def arm_slope(slopes: Array, arm_weight: Array) -> Array:
            arm_share = arm_weight / jnp.maximum(arm_weight.sum(0), 1e-6)[None]
            return (arm_share[:, None, None] * slopes).sum(0)

        slope_x = arm_slope(slopes_h, weight[count_v:])
        slope_y = arm_slope(jnp.swapaxes(slopes_v, 1, 2), weight[:count_v])
        squared = residual * residual
        # Pixels of another surface disagree at this disparity: they do not vote on it.
        belief = (saturation / (saturation + (share[:, None, None] * squared).sum(0))) ** 2
        belief = belief / jnp.maximum(belief.sum((0, 1)), 1e-12)[None, None]
        xx = (belief * slope_x * slope_x).sum((0, 1))
        yy = (belief * slope_y * slope_y).sum((0, 1))
        xy = (belief * slope_x * slope_y).sum((0, 1))
        centred_x = step_x - (share * step_x).sum(0)[None]
        centred_y = step_y - (share * step_y).sum(0)[None]
        along_x = (residual * (belief * slope_x)[None]).sum((1, 2))
        along_y = (residual * (belief * slope_y)[None]).sum((1, 2))
        gradient = (weight * (centred_x * along_x + centred_y * along_y)).sum(0)
        square = centred_x**2 * xx[None] + centred_y**2 * yy[None]
        information = (weight * (square + 2 * centred_x * centred_y * xy[None])).sum(0)
        per_view = (belief[None] * squared).sum((1, 2))
        core_view = squared[:, core, core].mean((1, 2))
        # Views that do not show the point have no say, but their loss has a price.
        trusted = jnp.where(anchored, weight, known)
        seen = trusted * known.sum(0)[None] / jnp.maximum(trusted.sum(0), 1e-6)[None] ** 2
        contrast = jnp.maximum(xx, yy)
        core_contrast = jnp.maximum(
            (slope_x * slope_x)[core, core].mean((0, 1)),
            (slope_y * slope_y)[core, core].mean((0, 1)),
        )
        pixel_residual = (seen[:, None, None] * squared).sum(0)
        pixel_contrast = jnp.maximum(slope_x**2, slope_y**2)

        def part(rows: slice, columns: slice) -> Array:
            ratio = pixel_contrast[rows, columns].mean((0, 1)) + contrast_floor
            return pixel_residual[rows, columns].mean((0, 1)) / ratio

        before, after = slice(half - 1, half + 1), slice(half, half + 2)
        halves = [part(core, before), part(core, after), part(before, core), part(after, core)]
        # The small constant keeps windows without contrast where they are.
        step = -gradient / (information + 1e-3)
        pixels = 1 / jnp.maximum((belief * belief).sum((0, 1)), 1e-12)
        return step, Refined(
            current,
            information * pixels,
            (seen * per_view).sum(0),
            contrast,
            core_contrast,
            core_view,
            jnp.stack(halves).min(0),
            per_view,
        )

    def agreeing() -> Array:
        """Weights of the views from how well they agree with the centre one at the start."""
        values_h, slopes_h = _sample(strips_h, steps_h, base_h, column, disparity, half)
        values_v, slopes_v = _sample(strips_v, steps_v, base_v, row, disparity, half)
        middle_h, middle_v = steps_h.shape[0] // 2, count_v // 2
        apart_v = (values_v - values_v[middle_v][None]) ** 2
        apart_h = (values_h - values_h[middle_h][None]) ** 2
        apart = jnp.concatenate([apart_v.mean((1, 2)), apart_h.mean((1, 2))])
        slope_h, slope_v = slopes_h[middle_h] ** 2, slopes_v[middle_v] ** 2
        slope = jnp.maximum(slope_h.mean((0, 1)), slope_v.mean((0, 1)))
        return known / (1 + apart / (robustness * (slope + 1.0))[None]) ** 2

    first = lax.cond(anchored, agreeing, lambda: known)

    def advance(carry: tuple[Array, Array, Refined], _: None) -> tuple[tuple, None]:
        current, weight = carry[:2]
        step, state = measure(current, weight)
        moved = jnp.clip(current + step, disparity - limit, disparity + limit)
        relative = state.inside / (robustness * (state.contrast + 1.0))[None]
        return (moved, known / (1 + relative) ** 2, state), None

    # One more round than steps, whose step is not taken: it measures where the last one led to.
    # (A separate call would double the program.)
    blank = no_points(disparity.shape[0], known.shape[0], disparity.dtype)._replace(
        inside=jnp.zeros_like(known)
    )
    (_, _, state), _ = lax.scan(advance, (disparity, first, blank), None, length=iterations + 1)
    return state._replace(inside=inside)


def refine_chunks(
    coefficients: tuple[Float[Array, "u y x"], Float[Array, "v x y"]],
    column: Int[Array, " n"],
    row: Int[Array, " n"],
    disparity: Float[Array, " n"],
    start: Float[Array, "s n"] | None,
    valid: Bool[Array, " n"],
    robustness: Float[Array, ""],
    saturation: Float[Array, ""],
    contrast_floor: Float[Array, ""],
    anchored: Bool[Array, ""],
    *,
    window: int,
    iterations: int,
    chunk: int,
) -> Refined:
    """`refine_points` in chunks that fit the cache; chunks without a valid point cost nothing.

    Args:
        coefficients: see `refine_points`, as for the other arguments.
        column: pixel of each point.
        row: pixel of each point.
        disparity: start.
        start: initial weight of each view, or None for 1.
        valid: which slots are points; the others come back as zeros.
        robustness: see `refine_points`.
        saturation: see `refine_points`.
        contrast_floor: see `refine_points`.
        anchored: see `refine_points`.
        window: side of the window.
        iterations: Gauss-Newton steps.
        chunk: points at a time; the number of slots must be a multiple of it.

    Returns:
        As `refine_points`.
    """
    views = coefficients[0].shape[0] + coefficients[1].shape[0]
    blocks = column.shape[0] // chunk

    def split(values: Array) -> Array:
        return jnp.moveaxis(values.reshape(*values.shape[:-1], blocks, chunk), -2, 0)

    def work(arguments: tuple[Array, ...]) -> Refined:
        x, y, d, weight = arguments
        return refine_points(
            coefficients,
            x,
            y,
            d,
            weight,
            robustness,
            saturation,
            contrast_floor,
            anchored,
            window=window,
            iterations=iterations,
        )

    @jax.checkpoint
    def one(arguments: tuple[Array, ...]) -> Refined:
        x, y, d, *rest, keep = arguments
        weight = rest[0] if rest else jnp.ones((views, chunk), d.dtype)
        nothing = no_points(chunk, views, d.dtype)
        return lax.cond(keep.any(), work, lambda _: nothing, (x, y, d, weight))

    inputs = [column, row, disparity] + ([] if start is None else [start]) + [valid]
    out = lax.map(one, tuple(split(a) for a in inputs))
    return jax.tree.map(
        lambda a: jnp.moveaxis(a, 0, -2).reshape(*a.shape[1:-1], blocks * chunk), out
    )
