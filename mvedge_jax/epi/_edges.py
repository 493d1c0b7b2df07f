"""The whole point stage: light field in, multi-view edge points out."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._params import cast
from ..color import srgb_to_gray, srgb_to_lab
from ..lightfield import LightField
from ._bank import FilterBank, prewitt_bank
from ._noise import noise_variance
from ._params import EdgeParams, EdgeSizes
from ._points import EdgePoints, Edges, EdgeStats
from ._refine import Refined, refine_chunks
from ._search import Maps, search, vertex
from ._spline import spline_coefficients
from ._support import neighbour_support


class Candidates(NamedTuple):
    """Pixels on an edge, in raster order: the gathers of the refinement then stay local."""

    row: Int[Array, " n"]
    column: Int[Array, " n"]
    valid: Bool[Array, " n"]
    found: Bool[Array, "2 n"]
    total: Int[Array, ""]
    overflow: Int[Array, ""]


def scene_banks(
    params: EdgeParams, sizes: EdgeSizes, views: tuple[int, ...]
) -> tuple[FilterBank, FilterBank]:
    """The filters of both arms: those of `params`, or Prewitt filters on the grid of `sizes`."""
    if params.banks is not None:
        return params.banks
    index = sizes.first + jnp.arange(sizes.filters, dtype=jnp.int32)
    disparity = index.astype(params.step.dtype) * params.step
    radius = max(sizes.radius(count) for count in views)
    return prewitt_bank(disparity, views[1], radius), prewitt_bank(disparity, views[0], radius)


def line_maxima(strength: Float[Array, "y x"], floor: Float[Array, ""]) -> Bool[Array, "y x"]:
    """Where a response is a local maximum along x, and above a floor."""
    left = jnp.pad(strength[:, :-1], ((0, 0), (1, 0)))
    right = jnp.pad(strength[:, 1:], ((0, 0), (0, 1)))
    return (strength > left) & (strength >= right) & (strength > floor)


def _candidates(maps: Maps, floor: Array, capacity: int) -> Candidates:
    across = line_maxima(maps.strength[0], floor)
    down = line_maxima(maps.strength[1].T, floor).T
    either = across | down
    strength = jnp.where(either, maps.strength.max(0), 0)
    count = either.sum()
    # The weakest go first where there are more candidates than slots, not the last ones.
    if capacity < strength.size:
        cut = jnp.sort(strength.reshape(-1))[strength.size - capacity - 1]
        either = either & ((count <= capacity) | (strength > cut))
    row, column = (
        axis.astype(jnp.int32) for axis in jnp.nonzero(either, size=capacity, fill_value=0)
    )
    kept = either.sum()
    valid = jnp.arange(capacity, dtype=kept.dtype) < kept
    found = jnp.stack([across[row, column], down[row, column]]) & valid[None]
    return Candidates(row, column, valid, found, count, count - kept)


def _subpixel(maps: Maps, candidates: Candidates) -> Float[Array, "n 2"]:
    """Vertex of the response along the direction, or directions, in which it is a maximum."""
    row, column = candidates.row, candidates.column
    height, width = maps.disparity.shape

    def at(arm: int, down: int, right: int) -> Array:
        y = jnp.clip(row + down, 0, height - 1)
        x = jnp.clip(column + right, 0, width - 1)
        return maps.strength[arm, y, x]

    middle_x, middle_y = at(0, 0, 0), at(1, 0, 0)
    shift_x = jnp.clip(vertex(at(0, 0, -1), middle_x, at(0, 0, 1)), -0.5, 0.5)
    shift_y = jnp.clip(vertex(at(1, -1, 0), middle_y, at(1, 1, 0)), -0.5, 0.5)
    shift = jnp.where(candidates.found, jnp.stack([shift_x, shift_y]), 0)
    return jnp.stack([column.astype(shift.dtype), row.astype(shift.dtype)], -1) + shift.T


def unit_gradient(gray: Float[Array, "y x"]) -> Float[Array, "y x 2"]:
    """Unit direction of the smoothed gradient, `(x, y)`; 0 where the image is flat."""
    taps = jnp.asarray([1.0, 4.0, 6.0, 4.0, 1.0], gray.dtype) / 16
    slope = jnp.asarray([-1.0, -2.0, 0.0, 2.0, 1.0], gray.dtype) / 8

    def along(image: Array, kernel: Array, axis: int) -> Array:
        margin = [(0, 0), (0, 0)]
        margin[axis] = (2, 2)
        padded = jnp.pad(image, margin, mode="edge")
        size = image.shape[axis]
        parts = [kernel[i] * jax.lax.slice_in_dim(padded, i, i + size, axis=axis) for i in range(5)]
        return sum(parts[1:], parts[0])

    gradient = jnp.stack(
        [along(along(gray, taps, 0), slope, 1), along(along(gray, taps, 1), slope, 0)], -1
    )
    square = (gradient**2).sum(-1, keepdims=True)
    safe = jnp.where(square > 1e-12, square, 1)
    return jnp.where(square > 1e-12, gradient / jnp.sqrt(safe), 0)


class Measured(NamedTuple):
    """All that is known of the candidates before any is judged."""

    maps: Maps
    candidates: Candidates
    refined: Refined


def measure_candidates(light_field: LightField, params: EdgeParams, sizes: EdgeSizes) -> Measured:
    """Searches and refines, but judges nothing: the first half of `multiview_edges`."""
    params = cast(params, light_field.views.dtype)
    across = light_field.horizontal_arm
    down = jnp.swapaxes(light_field.vertical_arm, 1, 2)
    gray = (100 * srgb_to_gray(across), 100 * srgb_to_gray(down))
    banks = scene_banks(params, sizes, light_field.views.shape[:2])
    noise = params.noise_gain * noise_variance(gray[0][light_field.centre[1]])
    saturation = params.saturation + noise
    maps = search(
        (srgb_to_lab(across), srgb_to_lab(down)),
        gray,
        banks,
        saturation,
        window=sizes.window,
        tile=sizes.tile,
    )
    candidates = _candidates(maps, params.strength_floor, sizes.capacity)
    row, column = candidates.row, candidates.column
    refined = refine_chunks(
        (spline_coefficients(gray[0], axis=-1), spline_coefficients(gray[1], axis=-1)),
        column,
        row,
        maps.disparity[row, column],
        None,
        candidates.valid,
        params.robustness,
        saturation,
        params.contrast_floor + noise,
        window=sizes.window,
        iterations=sizes.iterations,
        chunk=sizes.chunk,
    )
    return Measured(maps, candidates, refined)


@eqx.filter_jit
def multiview_edges(light_field: LightField, params: EdgeParams, sizes: EdgeSizes) -> Edges:
    """Finds edge points with accurate disparities, from the crosshair of a light field.

    1. A bank of oriented Prewitt filters gives edge strength and position along every horizontal
       and vertical EPI (Thesis 4.1.1). Local maxima along either direction become points, one per
       pixel.
    2. Windowed photo-consistency over both arms gives each its disparity; a few Gauss-Newton
       steps refine it. Pixels of other surfaces in the window and views that do not show the
       point lose their say.
    3. Points whose views disagree, or whose neighbours do, are dropped (Thesis 4.1.3 and 4.1.5 in
       effect; those tests are here under their own names, too).

    Args:
        light_field: only the crosshair of views is read; ground truth is not.
        params: see `EdgeParams`.
        sizes: see `EdgeSizes.for_light_field`.

    Returns:
        Points and statistics. Positions, disparities, confidences and errors are differentiable
        in the views and in every continuous parameter, at the selection made.

    Source: Thesis 4.1; REFERENCE_NOTES sections 1-9, 23 and 24 for where and why it differs.

    Example:
        >>> import jax.numpy as jnp
        >>> flat = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
        >>> edges = multiview_edges(flat, EdgeParams(), EdgeSizes.for_light_field(flat))
        >>> int(edges.stats.valid)
        0
    """
    params = cast(params, light_field.views.dtype)
    maps, candidates, refined = measure_candidates(light_field, params, sizes)
    row, column = candidates.row, candidates.column
    # The views are quantised: equal samples do not make a disparity certain.
    variance = refined.residual + params.noise_floor
    error = jnp.sqrt(variance / jnp.maximum(refined.information, 1e-6) + params.error_floor**2)
    mismatch = refined.mismatch
    precise = candidates.valid & (error < params.error_limit)
    consistent = precise & (mismatch < params.residual_limit)

    shape = maps.disparity.shape
    place = jnp.where(consistent, row * shape[1] + column, shape[0] * shape[1])

    def raster(values: Array) -> Array:
        flat = jnp.zeros(shape[0] * shape[1], values.dtype)
        return flat.at[place].set(values, mode="drop").reshape(shape)

    vote = 1 / (1 + mismatch / params.residual_limit)
    support = neighbour_support(
        raster(refined.disparity),
        raster(consistent),
        raster(vote),
        params.support_radius,
        params.support_tolerance,
    )[row, column]
    # A point that its neighbours agree with may have twice the residual, a lone one next to none.
    valid = precise & (mismatch < 2 * params.residual_limit * support)

    strength = jnp.where(candidates.found, maps.strength[:, row, column], 0).max(0)
    confidence = strength / (strength + params.confidence_scale) * vote
    view_mismatch = refined.view_residual / (refined.core_contrast + params.contrast_floor)[None]
    visible = refined.inside & (view_mismatch < params.visibility_limit)
    normal = unit_gradient(srgb_to_gray(light_field.centre_view))[row, column]

    def only(values: Array) -> Array:
        keep = valid.reshape(-1, *([1] * (values.ndim - 1)))
        return jnp.where(keep, values, jnp.zeros_like(values))

    points = EdgePoints(
        xy=only(_subpixel(maps, candidates)),
        disparity=only(refined.disparity),
        confidence=only(confidence),
        error=only(error),
        normal=only(normal),
        visible=only(visible.T),
        valid=valid,
    )
    stats = EdgeStats(
        candidates=candidates.total,
        overflow=candidates.overflow,
        consistent=consistent.sum(),
        valid=valid.sum(),
    )
    return Edges(points, stats)
