"""The whole point stage: light field in, multi-view edge points out."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._checks import checked_jit, expect, sound, with_numbers
from mvedge_jax._params import cast
from mvedge_jax.color import srgb_to_gray, srgb_to_lab
from mvedge_jax.epi import strongest_response
from mvedge_jax.image import highest, unit_gradient
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import (
    PhotometricParams,
    Scene,
    Sight,
    VolumeParams,
    first_labels,
    hypothesis_count,
    occluder_radius,
    prepare,
    sight,
)
from mvedge_jax.photometry.measuring import PhotometricLabels, view_weights

from ._candidates import contrast, find_candidates, subpixel
from ._params import EdgeParams, EdgeSizes
from ._points import EdgePoints, Edges, EdgeStats

# Weakest edge considered, in multiples of the noise: half of all pixels would be one without.
_ABOVE_NOISE = 3.0
# Standard deviation of a grey value over that of its three channels.
_OF_GRAY = 0.65
# Grey level, of 100, that some pixel of the 5x5 around a point must exceed: two of 255 steps, as in
# the vignetted corners of a lenslet camera.
_DARK = 0.8
# Strength, CIELAB units per px, at which the confidence is one half.
_CONFIDENT = 2.0
# Squared difference of a view from the others, in multiples of what they differ by among
# themselves, beyond which it does not show a point.
_DEVIATES = 2.5
# Half the width, px, of the windows in which hypotheses are compared, and passes over the
# neighbourhood of a measurement: those of `Sizes`.
_WINDOW, _PASSES = 2, 2


def _frontmost(
    measured: PhotometricLabels, limit: Array, step: float
) -> tuple[Float[Array, "y x"], Float[Array, "y x"]]:
    """Labels, on the borders of surfaces those of the nearer one, and their variances.

    A border belongs to the nearer surface, but shows half of either: it is itself measured
    worse than that surface is one pixel further on. Surfaces less than `step` apart, px per view
    step, are one; variances beyond `limit` tell none.
    """
    own, variance = measured.disparity, measured.variance
    best = jnp.where(variance < limit, own, -jnp.inf), variance
    for axis in (0, 1):
        margin = [(0, 0), (0, 0)]
        margin[axis] = (1, 1)
        labels = jnp.pad(best[0], margin, constant_values=-jnp.inf)
        others = jnp.pad(best[1], margin)
        size = own.shape[axis]
        for offset in (0, 2):
            label = lax.slice_in_dim(labels, offset, offset + size, axis=axis)
            other = lax.slice_in_dim(others, offset, offset + size, axis=axis)
            wins = label > best[0]
            best = jnp.where(wins, label, best[0]), jnp.where(wins, other, best[1])
    nearer = (best[0] > own + step) & (variance > 2 * best[1])
    return jnp.where(nearer, best[0], own), jnp.where(nearer, best[1], variance)


def _look(light_field: Any, params: Any, sizes: Any, **options: Any) -> tuple[Any, ...]:
    """The arguments of `multiview_edges`, or what is wrong with them."""
    order = "the order is (light_field, params, sizes)"
    wrapped = "`LightField(views)` makes one of an array [v, u, y, x, c], and " + order
    expect("light_field", light_field, LightField, wrapped)
    expect("params", params, EdgeParams, "`EdgeParams()` has the defaults, and " + order)
    chosen = "`EdgeSizes.for_light_field(light_field)` chooses them, and " + order
    expect("sizes", sizes, EdgeSizes, chosen)
    given = {name: None if part is None else with_numbers(part) for name, part in options.items()}
    return (light_field.bare(), with_numbers(params), sizes), given


@checked_jit(_look)
def multiview_edges(
    light_field: LightField,
    params: EdgeParams,
    sizes: EdgeSizes,
    *,
    volume: VolumeParams | None = None,
    photometric: PhotometricParams | None = None,
) -> Edges:
    """Finds edge points with accurate disparities, from the crosshair of a light field.

    1. A bank of oriented Prewitt filters gives edge strength and position along every horizontal
       and vertical EPI (Thesis 4.1.1). Local maxima along either direction become points, one per
       pixel; so do those of the centre view's own contrast, which lines that cross a stronger one
       need. Edges have to stand above the noise.
    2. Exposure, gains and noise are measured, and per pixel the disparity at which the unhidden
       half of either arm agrees best (`hypotheses`). Around it, the views that show a pixel are
       measured for its disparity and standard error (`labels`): the measurement that dense depth
       is made from, too.
    3. Points that the views do not determine are dropped, in place of Thesis 4.1.3 and 4.1.5.

    Args:
        light_field: only the crosshair of views is read; ground truth is not.
        params: see `EdgeParams`.
        sizes: see `EdgeSizes.for_light_field`.
        volume: of the hypotheses; None for the defaults.
        photometric: of the measurement; None for the defaults.

    Returns:
        Points and statistics. Positions, disparities, confidences and errors are differentiable
        in the views and in every continuous parameter, at the selection made.

    Raises:
        ValueError: outside `jit`, a parameter is not finite or is negative. Under `jit` such
            parameters give disparities of NaN.
        TypeError: an argument is of another kind, or their order is another.

    Source: Thesis 4.1; where it differs, and why, is a page of the documentation.

    Example:
        >>> import jax.numpy as jnp
        >>> flat = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
        >>> edges = multiview_edges(flat, EdgeParams(), EdgeSizes.for_light_field(flat))
        >>> int(edges.stats.valid)
        0
    """
    dtype = light_field.views.dtype
    steps = max(light_field.centre)
    low, high = sizes.ends
    span = high - low - 2 * sizes.spacing
    scene = prepare(
        light_field,
        sizes.hypotheses(hypothesis_count(span, steps), dtype),
        cast(VolumeParams() if volume is None else volume, dtype),
        window=_WINDOW,
    )
    measure = cast(PhotometricParams() if photometric is None else photometric, dtype)
    shape = light_field.views.shape[2:4]
    radius = occluder_radius(span, steps, (shape[0], shape[1]))
    seen = sight(scene, measure)
    measured = first_labels(scene, seen, radius=radius, passes=_PASSES)
    edges = measured_edges(scene, seen, measured, params, sizes=sizes, radius=radius)
    fine = sound(params) & (volume is None or sound(volume)) & sound(measure)
    # Selections drop NaN on the way: a parameter that is none would leave plausible points.
    disparity = jnp.where(fine, edges.points.disparity, jnp.asarray(jnp.nan, dtype))
    return eqx.tree_at(lambda found: found.points.disparity, edges, disparity)


def measured_edges(
    scene: Scene,
    seen: Sight,
    measured: PhotometricLabels,
    params: EdgeParams,
    *,
    sizes: EdgeSizes,
    radius: int,
) -> Edges:
    """The edge points of a scene that has been prepared: all of `multiview_edges` but step 2.

    Args:
        scene: with a first map.
        seen: its views.
        measured: what they say about every pixel, see `first_labels`.
        params: see `EdgeParams`.
        sizes: see `EdgeSizes`.
        radius: how far occluders are looked for, px.

    Returns:
        Points and statistics, as `multiview_edges`.
    """
    noise, view = scene.noise, jnp.moveaxis(scene.centre, 0, -1)
    across, down = (srgb_to_lab(jnp.moveaxis(arm.planes, 1, -1)) for arm in scene.arms)
    params, banks = cast(params, view.dtype), params.banks
    if banks is None:
        banks = sizes.banks((down.shape[0], across.shape[0]), view.dtype)
    strength = jnp.stack(
        [strongest_response(across, banks[0]), strongest_response(down, banks[1]).T]
    )
    centre = contrast(srgb_to_lab(view))
    grain = 100 * noise.deviation
    floor = params.strength_floor + _ABOVE_NOISE * noise.alpha * grain
    # A single view is noisier than what a filter averages.
    centre_floor = floor + _ABOVE_NOISE * grain
    candidates = find_candidates(strength, centre, floor, centre_floor, capacity=sizes.capacity)
    row, column = candidates.row, candidates.column

    limit = params.error_limit * jnp.sqrt(1 + noise.alpha * (_OF_GRAY * grain) ** 2)
    label, variance = _frontmost(measured, limit**2, 2 / max(across.shape[0] // 2, 1))
    disparity = label[row, column]
    error = jnp.sqrt(variance[row, column])
    # Where a lens gives no light at all, only the sensor's own pattern agrees between the views.
    # What belongs to the sensor is as much brighter as the views are.
    light = highest(100 * srgb_to_gray(view), 2)[row, column]
    lit = light > _DARK * scene.exposure.scale
    consistent = candidates.valid & (error < limit)
    valid = consistent & lit

    height = jnp.where(candidates.alone, centre[:, row, column], 0)
    height = jnp.where(candidates.found, strength[:, row, column], height).max(0)
    weights = view_weights(*seen.splines, measured.disparity, seen.params, radius=radius)
    normal = unit_gradient(srgb_to_gray(view))[row, column]

    def only(values: Array) -> Array:
        keep = valid.reshape(-1, *([1] * (values.ndim - 1)))
        return jnp.where(keep, values, jnp.zeros_like(values))

    points = EdgePoints(
        xy=only(subpixel(strength, centre, candidates)),
        disparity=only(disparity),
        confidence=only(height / (height + _CONFIDENT)),
        error=only(error),
        normal=only(normal),
        visible=only((weights[:, row, column] > 1 / (1 + _DEVIATES)).T),
        valid=valid,
    )
    stats = EdgeStats(candidates.total, candidates.overflow, consistent.sum(), valid.sum())
    return Edges(points, stats)
