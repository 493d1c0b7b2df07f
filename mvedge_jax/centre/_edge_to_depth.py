"""The whole chain: light field in, dense disparity of the centre view out."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from mvedge_jax._crosshair import Arm
from mvedge_jax._fence import staged
from mvedge_jax._params import cast
from mvedge_jax.color import srgb_to_gray
from mvedge_jax.diffusion import AutoSolver
from mvedge_jax.edges import (
    Bidirectional,
    BidirectionalParams,
    EdgePoints,
    Edges,
    EdgeStats,
    SurfaceParams,
    SurfaceVectors,
    bidirectional,
    choose,
    measured_edges,
    point_weight,
    rasterise,
    reprojection_score,
    share,
    surface_vectors,
    thesis_edges,
)
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import Exposure, Noise, Scene, Sight, first_labels, prepare, sight

from ._parameters import CentreParams, Parameters, Sizes
from ._sharpen import sharpen
from ._solves import AGREEMENT, Labels, dense_map, precision_weight, sparse_map, standard_error


class DepthStats(NamedTuple):
    """How the chain went.

    Attributes:
        edges: counts of the point stage.
        points: edge points that reached a pixel.
        sided: points with a surface vector.
        iterations: of the two directional diffusions and of every map, in order.
        converged: whether every diffusion of maps, slopes and errors reached its tolerance.
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
            from, its own and, where these are weak, those of its surroundings, which far from any
            label give way to the spread of the whole map; and what half a pixel of doubt about the
            place of a depth step amounts to. Infinite if there is no label at all.
        depth_edge: depth-edge confidence (Thesis, Section 4.3), px per px, `[y, x]`.
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
    6. A weighted median moves blurred depth steps onto colour steps; more solves follow, the last
       two with labels from all views, if these are asked for.

    Every light-field shape and every `sizes` is a program of its own, of some 2400 memory maps. A
    process that compiles more than about 25 should call `jax.clear_caches()` now and then: Linux
    allows 65530 maps, beyond which the compiler crashes.

    Args:
        params: see `Parameters`.
        light_field: the crosshair of views is read, or all of them (`Sizes.views`); ground truth is
            not.
        sizes: see `Sizes.for_light_field`.
        key: for the entropy search of the thesis' own points (`EdgeSizes.thesis`); nothing else is
            random.

    Returns:
        Disparity, standard error, points, statistics. Differentiable, forwards and backwards, in
        the views and in every leaf of `params` at the selections made: points, hypotheses, sides,
        levels of the median. A leaf that only selects is a threshold: its derivative is 0
        (`tests/centre/test_derivatives.py` lists them). In single precision the derivative of
        a single pixel is lost below 1e-38, and above 1e38 it is NaN: scale a loss that is smaller
        than 1e-10 or larger than 1e20. Rounding alone leaves single parameters' derivatives right
        to about 2e-4 there, as they are sums that cancel.

    Raises:
        ValueError: the light field has a single view per arm, or the entropy search has no `key`.

    Source: Thesis 6.1, 4.2.2 and 4.3 (sections); what differs, and why, is a page of the
        documentation.

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
    params, turned, sided = _completed(params, dtype)
    scene = prepare(
        light_field.without_truth(),
        sizes.edges.hypotheses(sizes.hypotheses, dtype),
        params.volume,
        window=sizes.window,
        search=sizes.dense or sizes.edges.thesis is None,
        every=sizes.views == "all",
    )
    every = light_field.without_truth() if sizes.views == "all" else None
    ready = staged(lambda scene, params, every: sight(scene, params, every=every))
    views = ready(scene, params.photometric, every)
    edges, first = _edges(scene, views, params, sizes, key)
    points, gray = edges.points, srgb_to_gray(jnp.moveaxis(scene.guide, 0, -1))
    shape = (gray.shape[0], gray.shape[1])

    coarse = AutoSolver(tolerance=jnp.asarray(100 * sizes.tolerance, dtype))
    directed = partial(bidirectional, normalised=sizes.side == "thesis", solver=coarse)
    passes = staged(directed)(points, gray, turned)
    choice = partial(_sides, sizes=sizes, shape=shape)
    surface = staged(choice)(points, passes, first, views.arms, sided)
    # Points take their disparity from few pixels, which noise leaves little of.
    clear = 1 - scene.noise.alpha
    params = eqx.tree_at(lambda p: p.centre.points, params, params.centre.points * clear)
    groups = params.centre, turned, sided
    from_points, hits = _point_labels(points, surface, passes, first, groups, sizes, shape)

    sharper = partial(
        sharpen,
        guide=scene.guide,
        params=params.median,
        radius=sizes.median_radius,
        levels=sizes.levels,
        mode=sizes.sharpening,
    )
    if first is None:
        start = 0.5 * (passes.forward + passes.backward)
        found = sparse_map(from_points, scene.lab, start, params, sizes)
        found = found._replace(disparity=sharper(found.disparity))
    else:
        found = dense_map(from_points, views, scene.lab, first, sharper, params, sizes)
    stats = DepthStats(
        edges.stats,
        jnp.sum(hits),
        jnp.sum(points.valid & (surface.score != 0)),
        jnp.concatenate([passes.iterations, found.iterations]),
        found.converged,
        scene.noise,
        scene.exposure,
    )
    error = standard_error(found.error, found.disparity)
    return DepthResult(found.disparity, error, passes.edge, points, surface, stats)


def _completed(
    params: Parameters, dtype: DTypeLike
) -> tuple[Parameters, BidirectionalParams, SurfaceParams]:
    """In the precision of the data, with defaults for the groups that were not given."""
    turned, sided = params.bidirectional, params.surface
    turned = BidirectionalParams() if turned is None else turned
    sided = SurfaceParams() if sided is None else sided
    return cast(params, dtype), cast(turned, dtype), cast(sided, dtype)


def _edges(
    scene: Scene, views: Sight, params: Parameters, sizes: Sizes, key: PRNGKeyArray | None
) -> tuple[Edges, Array | None]:
    """Points, and the map that every pixel's own measurement gives, if `sizes.dense`."""
    measure = partial(first_labels, radius=sizes.radius, passes=sizes.passes)
    if sizes.edges.thesis is not None:
        edges = thesis_edges(scene, params.edges, sizes.edges, key=key)
        return edges, measure(scene, views).disparity if sizes.dense else None
    measured = staged(measure)(scene, views)
    found = partial(measured_edges, sizes=sizes.edges, radius=sizes.radius)
    edges = staged(found)(scene, views, measured, params.edges)
    return edges, measured.disparity if sizes.dense else None


def _sides(
    points: EdgePoints,
    passes: Bidirectional,
    first: Array | None,
    arms: tuple[Arm, Arm],
    params: SurfaceParams,
    *,
    sizes: Sizes,
    shape: tuple[int, int],
) -> SurfaceVectors:
    """Surface vectors in the way that `sizes.side` names."""
    if sizes.side == "bidirectional":
        return surface_vectors(
            points, passes.response, first, params, shape=shape, relaxed=sizes.relaxed
        )
    if sizes.side == "thesis":
        score = passes.response
    elif sizes.side == "reprojection":
        score = reprojection_score(
            points, passes.forward, passes.backward, *arms, radius=sizes.radius
        )
    else:
        score = jnp.zeros_like(points.disparity)
    return choose(points, score, params, relaxed=sizes.relaxed)


def _point_labels(
    points: EdgePoints,
    surface: SurfaceVectors,
    passes: Bidirectional,
    first: Array | None,
    params: tuple[CentreParams, BidirectionalParams, SurfaceParams],
    sizes: Sizes,
    shape: tuple[int, int],
) -> tuple[Labels, Array]:
    """The points' labels on their surfaces, and which pixels have one."""
    centre, turned, sided = params
    precise = precision_weight(points.error**2, centre)
    if first is None:
        # As in (6.3), scaled so that the strongest weight is 1.
        limit = jnp.exp(turned.limit)
        weight = precise * (
            0.5 + 0.5 * point_weight(passes.confidence, points.valid, turned) / limit
        )
    else:
        weight = centre.points * points.confidence * precise
    weight = jnp.where(points.valid, weight, 0)
    if not sizes.relaxed:
        raster = rasterise(points.xy + surface.offset, points.disparity, points.valid, shape)
        return Labels(raster.values(weight), raster.values(points.disparity)), raster.hit
    total, mean = jnp.zeros(shape, weight.dtype), jnp.zeros(shape, weight.dtype)
    shift = sided.offset * points.normal
    for sign, share_of in ((1.0, surface.forward), (-1.0, 1 - surface.forward)):
        place, part = points.xy + sign * shift, weight * share_of
        if first is None:
            raster = rasterise(place, points.disparity, points.valid, shape)
            amount, value = raster.values(part), raster.values(points.disparity)
        else:
            agreement = jnp.asarray(AGREEMENT, weight.dtype)
            amount, value = share(place, points.disparity, part, first, agreement)
        total, mean = total + amount, mean + amount * value
    return Labels(total, mean / jnp.where(total > 0, total, 1)), total > 0
