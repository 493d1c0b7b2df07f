"""The whole point stage: light field in, multi-view edge points out."""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from .._params import cast
from ..color import srgb_to_gray, srgb_to_lab
from ..lightfield import LightField
from ..photometry import Noise, expose, measure_noise, rough_exposure
from ._bank import FilterBank, prewitt_bank
from ._candidates import Candidates, contrast, find_candidates, subpixel, unit_gradient
from ._noise import noise_variance
from ._params import EdgeParams, EdgeSizes
from ._points import EdgePoints, Edges, EdgeStats
from ._refine import Refined, no_points, refine_chunks, refinement_reach
from ._search import Maps, search
from ._spline import spline_coefficients
from ._support import frontmost, neighbour_support
from ._thesis import ThesisParams, thesis_points


def scene_banks(
    params: EdgeParams, sizes: EdgeSizes, views: tuple[int, ...]
) -> tuple[FilterBank, FilterBank]:
    """The filters of both arms: those of `params`, or Prewitt filters on the grid of `sizes`."""
    if params.banks is not None:
        return params.banks
    index = sizes.first + jnp.arange(sizes.filters, dtype=jnp.int32)
    disparity = index.astype(params.saturation.dtype) * sizes.step
    radius = max(sizes.radius(count) for count in views)
    return prewitt_bank(disparity, views[1], radius), prewitt_bank(disparity, views[0], radius)


# Weakest edge considered, in multiples of the noise: half of all pixels would be one without.
_ABOVE_NOISE = 3.0


class Measured(NamedTuple):
    """All that is known of the candidates before any is judged."""

    maps: Maps
    centre: Float[Array, "2 y x"]
    candidates: Candidates
    refined: Refined
    error_limit: Float[Array, ""]


def standard_error(refined: Refined, params: EdgeParams) -> Float[Array, " n"]:
    """Standard error of the disparities, px."""
    # The views are quantised: equal samples do not make a disparity certain.
    variance = refined.residual + params.noise_floor
    return jnp.sqrt(variance / jnp.maximum(refined.information, 1e-6) + params.error_floor**2)


def _passes(
    refined: Refined, params: EdgeParams, error_limit: Float[Array, ""]
) -> Bool[Array, " n"]:
    precise = standard_error(refined, params) < error_limit
    return precise & (refined.mismatch < params.residual_limit)


class _Attempts(NamedTuple):
    refined: Refined
    wanted: Bool[Array, " n"]
    start: Float[Array, " n"]


def _highest(values: Float[Array, "y x"]) -> Float[Array, "y x"]:
    """Maximum over 5x5 pixels."""
    return lax.reduce_window(values, -jnp.inf, lax.max, (5, 5), (1, 1), "SAME")


def measure_candidates(
    light_field: LightField,
    params: EdgeParams,
    sizes: EdgeSizes,
    *,
    scene_noise: Noise | None = None,
) -> Measured:
    """Searches and refines, but judges nothing: the first half of `multiview_edges`."""
    params = cast(params, light_field.views.dtype)
    if scene_noise is None:
        view = jnp.moveaxis(light_field.centre_view, -1, 0)
        scene_noise = measure_noise(view, jnp.ones((), view.dtype))
    across = light_field.horizontal_arm
    down = jnp.swapaxes(light_field.vertical_arm, 1, 2)
    gray = (100 * srgb_to_gray(across), 100 * srgb_to_gray(down))
    banks = scene_banks(params, sizes, light_field.views.shape[:2])
    noise = params.noise_gain * noise_variance(gray[0][light_field.centre[1]])
    saturation = params.saturation + noise
    error_limit = params.error_limit * jnp.sqrt(1 + noise)
    maps = search(
        (srgb_to_lab(across), srgb_to_lab(down)),
        gray,
        banks,
        saturation,
        window=sizes.window,
        tile=sizes.tile,
    )
    centre = contrast(srgb_to_lab(light_field.centre_view))
    # The difference of two noisy values in three channels; two standard deviations.
    floor = params.strength_floor + _ABOVE_NOISE * 100 * scene_noise.alpha * scene_noise.deviation
    centre_floor = floor + 2 * jnp.sqrt(6 * noise)
    candidates = find_candidates(maps, centre, floor, centre_floor, capacity=sizes.capacity)
    row, column = candidates.row, candidates.column
    shape = maps.disparity.shape
    coefficients = (
        spline_coefficients(gray[0], axis=-1),
        spline_coefficients(gray[1], axis=-1),
    )

    blank = no_points(sizes.capacity, sum(light_field.views.shape[:2]), light_field.views.dtype)
    # The border itself, not what is beside it: there the nearer disparity fits a plain surface too.
    strongest = lax.stop_gradient(centre.max(0))
    ridge = (strongest > 0.9 * _highest(strongest))[row, column]
    reach = refinement_reach(max(light_field.views.shape[:2]))

    def attempt(carry: _Attempts, index: Int[Array, ""]) -> tuple[_Attempts, None]:
        """Refines the candidates that want it, packed together, and keeps what is better."""
        refined, wanted, start = carry
        order = jnp.nonzero(wanted, size=sizes.capacity, fill_value=0)[0].astype(jnp.int32)
        count = wanted.sum().astype(jnp.int32)
        packed = refine_chunks(
            coefficients,
            column[order],
            row[order],
            start[order],
            None,
            jnp.arange(sizes.capacity, dtype=jnp.int32) < count,
            params.robustness,
            params.refine_saturation + noise,
            params.contrast_floor + noise,
            index == 1,
            window=sizes.window,
            iterations=sizes.iterations,
            chunk=sizes.chunk,
        )
        slot = jnp.maximum(jnp.cumsum(wanted.astype(jnp.int32)) - 1, 0)
        tried = jax.tree.map(lambda leaf: leaf[..., slot], packed)
        # A disparity that only the neighbours propose has to be theirs, and clearly so.
        near = jnp.abs(tried.disparity - start) < params.support_tolerance
        near = near & (tried.mismatch < 0.5 * params.residual_limit)
        better = wanted & (
            (index == 0) | (_passes(tried, params, error_limit) & (near | (index == 1)))
        )
        refined = jax.tree.map(lambda a, b: jnp.where(better, b, a), refined, tried)
        passes = candidates.valid & _passes(refined, params, error_limit)

        def nearer() -> tuple[Array, Array]:
            place = jnp.where(passes, row * shape[1] + column, shape[0] * shape[1])
            nobody = jnp.full(shape[0] * shape[1], sizes.capacity, jnp.int32)
            own = jnp.arange(sizes.capacity, dtype=jnp.int32)
            slot, _ = frontmost(
                nobody.at[place].set(own, mode="drop").reshape(shape), refined.disparity
            )
            slot = slot[row, column]
            known = slot < sizes.capacity
            front = refined.disparity[jnp.where(known, slot, 0)]
            between = front - refined.disparity > reach
            return known & candidates.valid & ridge & (between | ~passes), front

        wanted, start = lax.cond(
            index == 1, nearer, lambda: (candidates.valid & ~passes, maps.disparity[row, column])
        )
        return _Attempts(refined, wanted, jnp.where(wanted, start, 0)), None

    # 1. All views. 2. What fails: the views that agree with the centre one, since a nearer surface
    # hides it from the others. (Not at first: a few views agree with much by accident.) 3. What
    # fails, or has a nearer surface beside it: the disparity of that. The border between two
    # surfaces belongs to the nearer one, however well the farther one agrees on its side.
    everything = _Attempts(blank, candidates.valid, maps.disparity[row, column])
    (refined, *_), _ = lax.scan(attempt, everything, jnp.arange(3, dtype=jnp.int32))
    return Measured(maps, centre, candidates, refined, error_limit)


def _thesis_edges(
    light_field: LightField, params: EdgeParams, sizes: EdgeSizes, key: PRNGKeyArray | None
) -> Edges:
    assert sizes.thesis is not None
    own = ThesisParams() if params.thesis is None else params.thesis
    found = thesis_points(
        (
            srgb_to_lab(light_field.horizontal_arm),
            srgb_to_lab(jnp.swapaxes(light_field.vertical_arm, 1, 2)),
        ),
        light_field.centre_view,
        scene_banks(params, sizes, light_field.views.shape[:2]),
        cast(own, light_field.views.dtype),
        params.strength_floor,
        sizes.thesis,
        capacity=sizes.capacity,
        key=key,
    )
    height, width = light_field.views.shape[2:4]
    column = jnp.clip(jnp.round(found.xy[:, 0]).astype(jnp.int32), 0, width - 1)
    row = jnp.clip(jnp.round(found.xy[:, 1]).astype(jnp.int32), 0, height - 1)
    normal = unit_gradient(srgb_to_gray(light_field.centre_view))[row, column]
    confidence = found.strength / (found.strength + params.confidence_scale)
    # All that is known of a line's precision is the spacing of the filters.
    error = jnp.full_like(found.disparity, sizes.step / math.sqrt(12))
    points = EdgePoints(
        found.xy, found.disparity, confidence, error, normal, found.visible, found.valid
    )
    points = jax.tree.map(
        lambda leaf: jnp.where(
            found.valid.reshape(-1, *[1] * (leaf.ndim - 1)), leaf, jnp.zeros_like(leaf)
        ),
        points,
    )
    return Edges(points, EdgeStats(found.lines, found.overflow, found.kept, found.valid.sum()))


@eqx.filter_jit
def multiview_edges(
    light_field: LightField,
    params: EdgeParams,
    sizes: EdgeSizes,
    *,
    key: PRNGKeyArray | None = None,
) -> Edges:
    """Finds edge points with accurate disparities, from the crosshair of a light field.

    0. Exposure and gains of the views are taken out; edges have to stand above the noise.
    1. A bank of oriented Prewitt filters gives edge strength and position along every horizontal
       and vertical EPI (Thesis 4.1.1). Local maxima along either direction become points, one per
       pixel; so do those of the centre view's own contrast, which lines that cross a stronger one
       need.
    2. Windowed photo-consistency over both arms gives each its disparity; a few Gauss-Newton
       steps refine it. Pixels of other surfaces in the window and views that do not show the
       point lose their say. What fails is tried again with the views that agree with the centre
       one: a line that passes behind a nearer one is hidden in the others.
    3. Points whose views disagree, or whose neighbours do, are dropped (Thesis 4.1.3 and 4.1.5 in
       effect; those tests are here under their own names, too).

    Args:
        light_field: only the crosshair of views is read; ground truth is not.
        params: see `EdgeParams`.
        sizes: see `EdgeSizes.for_light_field`. With `sizes.thesis`, the thesis' own chain runs
            instead: fitted lines, alignment, vote, entropy search, joint filter (`ThesisSteps`).
        key: for the entropy search of that chain; nothing else is random.

    Returns:
        Points and statistics. Positions, disparities, confidences and errors are differentiable
        in the views and in every continuous parameter, at the selection made.

    Raises:
        ValueError: if the entropy search is asked for without `key`.

    Source: Thesis 4.1; REFERENCE_NOTES sections 1-9, 23 and 24 for where and why it differs.

    Example:
        >>> import jax.numpy as jnp
        >>> flat = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
        >>> edges = multiview_edges(flat, EdgeParams(), EdgeSizes.for_light_field(flat))
        >>> int(edges.stats.valid)
        0
    """
    exposure = rough_exposure(light_field)
    light_field = expose(light_field, exposure)
    noise = measure_noise(jnp.moveaxis(light_field.centre_view, -1, 0), exposure.scale)
    return exposed_edges(light_field, exposure.scale, noise, params, sizes, key=key)


def exposed_edges(
    light_field: LightField,
    scale: Float[Array, ""],
    noise: Noise,
    params: EdgeParams,
    sizes: EdgeSizes,
    *,
    key: PRNGKeyArray | None = None,
) -> Edges:
    """The work of `multiview_edges`, on views whose exposure and gains have been taken out."""
    params = cast(params, light_field.views.dtype)
    # What belongs to the sensor is as much brighter as the views are.
    params = eqx.tree_at(
        lambda p: (p.dark_limit, p.noise_floor),
        params,
        (params.dark_limit * scale, params.noise_floor * scale**2),
    )
    if sizes.thesis is not None:
        return _thesis_edges(light_field, params, sizes, key)
    maps, centre, candidates, refined, error_limit = measure_candidates(
        light_field, params, sizes, scene_noise=noise
    )
    row, column = candidates.row, candidates.column
    error = standard_error(refined, params)
    mismatch = refined.mismatch
    # Where a lens gives no light at all, only the sensor's own pattern agrees between the views.
    lit = _highest(100 * srgb_to_gray(light_field.centre_view)) > params.dark_limit
    precise = candidates.valid & lit[row, column] & (error < error_limit)
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

    strength = jnp.where(candidates.alone, centre[:, row, column], 0)
    strength = jnp.where(candidates.found, maps.strength[:, row, column], strength).max(0)
    confidence = strength / (strength + params.confidence_scale) * vote
    view_mismatch = refined.view_residual / (refined.core_contrast + params.contrast_floor)[None]
    visible = refined.inside & (view_mismatch < params.visibility_limit)
    normal = unit_gradient(srgb_to_gray(light_field.centre_view))[row, column]

    def only(values: Array) -> Array:
        keep = valid.reshape(-1, *([1] * (values.ndim - 1)))
        return jnp.where(keep, values, jnp.zeros_like(values))

    points = EdgePoints(
        xy=only(subpixel(maps, centre, candidates)),
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
