"""The whole chain: light field in, dense disparity of the centre view out."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from mvedge_jax._crosshair import Arm
from mvedge_jax._fence import recomputed, staged
from mvedge_jax._params import cast
from mvedge_jax.color import srgb_to_gray
from mvedge_jax.diffusion import Solver, System, diffuse
from mvedge_jax.epi import EdgePoints, EdgeStats, measured_edges, thesis_edges
from mvedge_jax.lightfield import LightField
from mvedge_jax.occlusion import (
    Bidirectional,
    SurfaceVectors,
    bidirectional,
    choose,
    point_weight,
    rasterise,
    reprojection_score,
    share,
    surface_vectors,
)
from mvedge_jax.photometry import (
    Exposure,
    Look,
    Noise,
    PhotometricLabels,
    Sight,
    first_labels,
    gaussian,
    labels,
    look,
    mismatch,
    prepare,
    sight,
)

from ._parameters import CentreParams, Parameters, Sizes
from ._sharpen import sharpen
from ._slant import rises, slope_labels
from ._smoothness import edge_smoothness

# Labels beside each other share views and windows, so that their mean is known less well than their
# own standard errors say. From five scenes, in which 93 % of all pixels are then within twice the
# error (`experiments/calibration.py`).
_SHARED = 1.2
# Where the Gaussian is cut that a map passes before its steps cut edges, px.
_BLUR = 2
# A depth step is found to half a pixel.
_MISPLACED = 0.5


class DepthStats(NamedTuple):
    """How the chain went.

    Attributes:
        edges: counts of the point stage.
        points: edge points that reached a pixel.
        sided: points with a surface vector.
        iterations: of every diffusion, in order.
        converged: whether every diffusion reached its tolerance.
        noise: of the views, in their units after `exposure` was taken out.
        exposure: what was taken out of the views before they were compared.
    """

    edges: EdgeStats
    points: Int[Array, ""]
    sided: Int[Array, ""]
    iterations: Int[Array, " solves"]
    converged: Bool[Array, ""]
    noise: Noise
    exposure: Exposure


class DepthResult(NamedTuple):
    """Depth of the centre view, with what it was made from.

    Attributes:
        disparity: px per view step, larger is nearer, `[y, x]`.
        error: standard error of the disparity, px, `[y, x]`: of the labels that a pixel was made
            from, its own and, where these are weak, those of its surroundings, and what half a
            pixel of doubt about the place of a depth step amounts to. Infinite if there is no
            label at all.
        depth_edge: depth-edge confidence (4.3), px per px, `[y, x]`.
        points: the multi-view edges.
        surface: their surface vectors, scores and probabilities.
        stats: counts and iterations.
    """

    disparity: Float[Array, "y x"]
    error: Float[Array, "y x"]
    depth_edge: Float[Array, "y x"]
    points: EdgePoints
    surface: SurfaceVectors
    stats: DepthStats


class _Labels(NamedTuple):
    """Labels and data weights per pixel."""

    weight: Array
    value: Array


@eqx.filter_jit
def edge_to_depth(
    params: Parameters,
    light_field: LightField,
    sizes: Sizes,
    *,
    key: PRNGKeyArray | None = None,
) -> DepthResult:
    """Estimates the disparity of every pixel of the centre view.

    1. Brightness and noise are measured once: gains of the views, again along the first map, are
       taken out; noise above that of 8 bits has the guide denoised, views blurred, costs pooled
       and points weigh less.
    2. Hypotheses: per pixel, the disparity at which the unhidden half of either arm agrees best,
       along paths through the image where the pixel alone does not tell. Around it, every pixel is
       measured in the views that show it.
    3. Multi-view edges: filters in EPIs say where (Thesis 4.1), the measurement at which disparity.
    4. Bidirectional diffusion and what surrounds each edge give its surface vector, which
       moves the label onto the surface that it was measured on (4.2.2).
    5. Diffusion (6.1), repeated, between labels weighted by their standard errors: those of the
       edges, and one per pixel measured in the views around the previous map, occluded views left
       out. Smoothness ends where a colour step and a depth step of that map meet.
    6. A weighted median moves blurred depth steps onto colour steps; more solves follow.

    Every light-field shape and every `sizes` is a program of its own, of some 2400 memory maps. A
    process that compiles more than about 25 should call `jax.clear_caches()` now and then: Linux
    allows 65530 maps, beyond which the compiler crashes.

    Args:
        params: see `Parameters`.
        light_field: the crosshair of views is read; ground truth is not.
        sizes: see `Sizes.for_light_field`.
        key: for the entropy search of the thesis' own points (`EdgeSizes.thesis`); nothing else is
            random.

    Returns:
        Disparity, standard error, points, statistics. Differentiable, forwards and backwards, in
        the views and in every leaf of `params` at the selections made: points, hypotheses, sides,
        levels of the median. A leaf that only selects is a threshold: its derivative is 0
        (`tests/reconstruct/test_derivatives.py` lists them).

    Raises:
        ValueError: the light field has a single view per arm, or the entropy search has no `key`.

    Source: Thesis 6.1; 4.2.2; 4.3. What differs, and why, is in the list above.

    Example:
        >>> import jax.numpy as jnp
        >>> flat = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
        >>> result = edge_to_depth(Parameters(), flat, Sizes.for_light_field(flat))
        >>> bool(jnp.isfinite(result.disparity).all())
        True
    """
    if max(light_field.views.shape[:2]) < 3:
        raise ValueError(
            "`light_field` must have at least three views in a row or in a column, got a grid of "
            f"{light_field.views.shape[0]}x{light_field.views.shape[1]}."
        )
    dtype = light_field.views.dtype
    light_field = light_field.without_truth()
    params = cast(params, dtype)
    thesis = sizes.edges.thesis is not None
    scene = prepare(
        light_field,
        sizes.edges.hypotheses(sizes.hypotheses, dtype),
        params.volume,
        window=sizes.window,
        search=sizes.dense or not thesis,
    )
    noise, guide, lab = scene.noise, scene.guide, scene.lab
    gray = srgb_to_gray(jnp.moveaxis(guide, 0, -1))
    shape = (gray.shape[0], gray.shape[1])
    views = staged(sight)(scene, params.photometric)
    # Points take their disparity from few pixels, which noise leaves little of.
    params = eqx.tree_at(
        lambda p: (p.photometric, p.centre.points),
        params,
        (views.params, params.centre.points * (1 - noise.alpha)),
    )
    measure = partial(first_labels, radius=sizes.radius, passes=sizes.passes)
    if thesis:
        edges = thesis_edges(scene, params.edges, sizes.edges, key=key)
        first = measure(scene, views).disparity if sizes.dense else None
    else:
        measured = staged(measure)(scene, views)
        edges = staged(lambda *of: measured_edges(*of, sizes=sizes.edges, radius=sizes.radius))(
            scene, views, measured, params.edges
        )
        first = measured.disparity if sizes.dense else None
    points = edges.points

    coarse = Solver(tolerance=10 * params.centre.tolerance)
    directed = partial(bidirectional, normalised=sizes.side == "thesis", solver=coarse)
    passes = staged(directed)(points, gray, params.bidirectional)
    surface = staged(lambda *of: _sides(*of, sizes=sizes, shape=shape))(
        points, passes, first, views.arms, params
    )
    from_points, hits = _point_labels(points, surface, passes, first, params, sizes, shape)

    def sharper(disparity: Array) -> Array:
        return sharpen(
            disparity,
            guide,
            params.median,
            radius=sizes.median_radius,
            levels=sizes.levels,
            mode=sizes.sharpening,
        )

    if first is None:
        start = 0.5 * (passes.forward + passes.backward)
        found = _sparse_map(from_points, lab, start, params, sizes)
        found = found._replace(disparity=sharper(found.disparity))
    else:
        found = _dense_map(from_points, views, lab, first, sharper, params, sizes)
    stats = DepthStats(
        edges.stats,
        jnp.sum(hits),
        jnp.sum(points.valid & (surface.score != 0)),
        jnp.concatenate([passes.iterations, found.iterations]),
        found.converged,
        noise,
        scene.exposure,
    )
    error = _standard_error(found.error, found.disparity)
    return DepthResult(found.disparity, error, passes.edge, points, surface, stats)


def _sides(
    points: EdgePoints,
    passes: Bidirectional,
    first: Array | None,
    arms: tuple[Arm, Arm],
    params: Parameters,
    *,
    sizes: Sizes,
    shape: tuple[int, int],
) -> SurfaceVectors:
    """Surface vectors in the way that `sizes.side` names."""
    if sizes.side == "bidirectional":
        return surface_vectors(
            points, passes.response, first, params.surface, shape=shape, relaxed=sizes.relaxed
        )
    if sizes.side == "thesis":
        score = passes.response
    elif sizes.side == "reprojection":
        score = reprojection_score(
            points, passes.forward, passes.backward, *arms, radius=sizes.radius
        )
    else:
        score = jnp.zeros_like(points.disparity)
    return choose(points, score, params.surface, relaxed=sizes.relaxed)


def _point_labels(
    points: EdgePoints,
    surface: SurfaceVectors,
    passes: Bidirectional,
    first: Array | None,
    params: Parameters,
    sizes: Sizes,
    shape: tuple[int, int],
) -> tuple[_Labels, Array]:
    """The points' labels on their surfaces, and which pixels have one."""
    precise = _precision_weight(points.error**2, params.centre)
    if first is None:
        # As in (6.3), scaled so that the strongest weight is 1.
        limit = jnp.exp(params.bidirectional.limit)
        weight = precise * (
            0.5 + 0.5 * point_weight(passes.confidence, points.valid, params.bidirectional) / limit
        )
    else:
        weight = params.centre.points * points.confidence * precise
    weight = jnp.where(points.valid, weight, 0)
    if not sizes.relaxed:
        raster = rasterise(points.xy + surface.offset, points.disparity, points.valid, shape)
        return _Labels(raster.values(weight), raster.values(points.disparity)), raster.hit
    total, mean = jnp.zeros(shape, weight.dtype), jnp.zeros(shape, weight.dtype)
    shift = params.surface.offset * points.normal
    for sign, share_of in ((1.0, surface.forward), (-1.0, 1 - surface.forward)):
        place, part = points.xy + sign * shift, weight * share_of
        if first is None:
            raster = rasterise(place, points.disparity, points.valid, shape)
            amount, value = raster.values(part), raster.values(points.disparity)
        else:
            amount, value = share(place, points.disparity, part, first, params.centre.agreement)
        total, mean = total + amount, mean + amount * value
    return _Labels(total, mean / jnp.where(total > 0, total, 1)), total > 0


class _Map(NamedTuple):
    """A map, the standard error of its labels, and how the diffusions went."""

    disparity: Array
    error: Array
    iterations: Array
    converged: Array


def _sparse_map(
    labels: _Labels, lab: Array, start: Array, params: Parameters, sizes: Sizes
) -> _Map:
    """Repeated diffusion of the points' labels alone."""

    def solve(state: tuple[Array, Array], turn: Array) -> Any:
        smooth = gaussian(state[0], params.centre.blur, _BLUR)
        edges = edge_smoothness(lab, smooth, params.smoothness)
        last = turn == sizes.solves - 1
        return _solved(labels, edges, state[0], params.centre, sloped=jnp.asarray(False), last=last)

    return _Map(*_repeated(solve, start, sizes.solves))


def _dense_map(
    from_points: _Labels,
    views: Sight,
    lab: Array,
    first: Array,
    sharper: Callable[[Array], Array],
    params: Parameters,
    sizes: Sizes,
) -> _Map:
    """Repeated measurement in the views and diffusion, with slopes from the second solve on."""

    def seen(disparity: Array) -> tuple[Look, Array]:
        found = look(*views.splines, disparity, params.photometric, radius=sizes.radius)
        residual = mismatch(found, lab, disparity, params.photometric, passes=sizes.passes)
        return found, residual

    def plain(disparity: Array, turn: Array) -> tuple[Array, Look]:
        return disparity, seen(disparity)[0]

    def sharpened(disparity: Array, turn: Array) -> tuple[Array, Look]:
        both = jnp.stack([disparity, sharper(disparity)])
        found, (before, after) = lax.map(jax.checkpoint(seen), both)
        slack = jnp.where(turn == 0, params.centre.worse_first, params.centre.worse)
        keep = after > slack * (before + 2 * params.photometric.noise**2)
        # What was seen of the chosen map need not be looked up again.
        return jax.tree.map(lambda pair: jnp.where(keep, pair[0], pair[1]), (both, found))

    turns = sizes.solves if sizes.sharpening == "none" else 2 * sizes.solves

    def solve(state: tuple[Array, Array], turn: Array) -> Any:
        disparity, _ = state
        # Sharpening inside of the loop, at its turn, keeps the program small: one solver, not two.
        if sizes.sharpening == "none":
            disparity, found = plain(disparity, turn)
        else:
            due = turn % sizes.solves == 0
            disparity, found = lax.cond(due, sharpened, plain, disparity, turn)
        measured = labels(
            found, lab, disparity, params.photometric, views.views, passes=sizes.passes
        )
        both = _with_dense(from_points, measured, disparity, params)
        smooth = gaussian(disparity, params.centre.blur, _BLUR)
        edges = edge_smoothness(lab, smooth, params.smoothness)
        return _solved(
            both, edges, disparity, params.centre, sloped=turn > 0, last=turn == turns - 1
        )

    return _Map(*_repeated(solve, first, turns))


def _repeated(solve: Callable[..., Any], start: Array, turns: int) -> tuple[Array, ...]:
    """Runs `solve` from a map: the fields of a `_Map`."""
    state = (start, jnp.zeros_like(start))
    (disparity, error), (iterations, converged) = lax.scan(
        recomputed(solve), state, jnp.arange(turns)
    )
    return disparity, error, iterations, jnp.all(converged)


def _standard_error(
    of_labels: Float[Array, "y x"], disparity: Float[Array, "y x"]
) -> Float[Array, "y x"]:
    """That of the labels, and of the place of the map's steps; infinite without labels."""
    across, down = jnp.abs(jnp.diff(disparity, axis=1)), jnp.abs(jnp.diff(disparity, axis=0))
    steepest = jnp.zeros_like(disparity)
    for side in ((0, 1), (1, 0)):
        steepest = jnp.maximum(steepest, jnp.pad(across, ((0, 0), side)))
        steepest = jnp.maximum(steepest, jnp.pad(down, (side, (0, 0))))
    known = of_labels > 0
    labels = _SHARED * jnp.where(known, of_labels, 1)
    return jnp.where(known, jnp.sqrt(labels**2 + (_MISPLACED * steepest) ** 2), jnp.inf)


def _solved(
    labels: _Labels,
    edges: tuple[Array, Array],
    start: Array,
    params: CentreParams,
    *,
    sloped: Array,
    last: Array,
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Diffuses labels into a map, from `start`; if `sloped`, along the slopes of `start`.

    For either slope, for the map and, at `last`, for its error, a solve each, one after the other
    by a loop: the solver compiles slowly.

    Returns:
        The map and, at `last`, the standard error of the labels that every pixel is made from, 0
        without labels; iterations and convergence of the map's own solve.
    """
    held, slopes = slope_labels(
        start, labels.weight, edges, steepest=params.steepest, flat=params.flat
    )
    # What a label of this weight is known to, and at best a tenth of what counts half.
    uncertain = params.precision * jnp.sqrt(1 / jnp.clip(labels.weight, 1e-9, 0.99) - 1)
    slope, whole, nothing = params.slant, params.smoothness, jnp.zeros_like(start)
    items = (
        jnp.arange(4),
        jnp.stack([sloped, sloped, jnp.asarray(True), last]),
        jnp.concatenate([held, jnp.stack([labels.weight, labels.weight])]),
        jnp.concatenate([slopes, jnp.stack([labels.value, uncertain])]),
        jnp.stack([nothing, nothing, start, nothing]),
        jnp.stack([slope, slope, whole, whole]),
        params.tolerance * jnp.asarray([10, 10, 1, 10], start.dtype),
    )

    def solve(found: Array, item: tuple[Array, ...]) -> tuple[Array, tuple[Array, Array]]:
        index, wanted, weight, label, start, stiffness, tolerance = item
        asked = [jnp.where(index == 2, rise, 0) for rise in rises(found[:2])]
        tx, ty = (stiffness * t for t in edges)

        def solved() -> tuple[Array, tuple[Array, Array]]:
            system = System(weight, label, tx, ty, *asked)
            result = diffuse(system, start=start, solver=Solver(tolerance=tolerance))
            return result.value, (result.stats.iterations, result.stats.converged)

        def skipped() -> tuple[Array, tuple[Array, Array]]:
            return nothing, (jnp.zeros((), jnp.int32), jnp.asarray(True))

        value, stats = lax.cond(wanted, solved, skipped)
        return lax.dynamic_update_index_in_dim(found, value, index, 0), stats

    found, (iterations, converged) = lax.scan(solve, jnp.zeros_like(items[2]), items)
    return (found[2], found[3]), (iterations[2], jnp.all(converged))


def _with_dense(
    from_points: _Labels, measured: PhotometricLabels, disparity: Array, params: Parameters
) -> _Labels:
    """Labels of the points together with one measured at every pixel."""
    floor = params.photometric.noise**2
    excess = jnp.maximum(measured.residual, floor) / (params.centre.trust * floor)
    weight = _precision_weight(measured.variance, params.centre) / (1 + excess**2)
    distance = (from_points.value - disparity) / params.centre.agreement
    sparse = from_points.weight / (1 + distance**2) ** 2
    anchor = params.centre.anchor
    total = weight + sparse + anchor
    sums = weight * measured.disparity + sparse * from_points.value + anchor * disparity
    return _Labels(total, sums / jnp.maximum(total, jnp.finfo(total.dtype).tiny))


def _precision_weight(variance: Array, params: CentreParams) -> Array:
    precision = params.precision**2
    return precision / (precision + variance)
