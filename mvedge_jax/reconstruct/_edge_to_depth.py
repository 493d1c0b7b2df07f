"""The whole chain: light field in, dense disparity of the centre view out."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._crosshair import Arm, crosshair
from mvedge_jax._params import cast
from mvedge_jax.color import srgb_to_gray, srgb_to_lab
from mvedge_jax.diffusion import Solver, System, diffuse
from mvedge_jax.epi import EdgePoints, EdgeStats
from mvedge_jax.epi._edges import exposed_edges
from mvedge_jax.epi._spline import spline_coefficients
from mvedge_jax.lightfield import LightField
from mvedge_jax.occlusion import (
    Bidirectional,
    SurfaceVectors,
    bidirectional,
    choose,
    point_weight,
    rasterise,
    reprojection_score,
    surface_vectors,
)
from mvedge_jax.photometry import (
    Exposure,
    Noise,
    denoised,
    expose,
    exposure_along,
    low_pass,
    measure_noise,
    rough_exposure,
)

from ._parameters import CentreParams, Parameters, Sizes
from ._photometric import photometric_labels
from ._sharpen import sharpen
from ._smoothness import edge_smoothness
from ._volume import hypotheses


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
        confidence: weight of the labels that a pixel received, in [0, 1]: 0 where it was filled in
            from its neighbours, `[y, x]`.
        depth_edge: depth-edge confidence (4.3), px per px, `[y, x]`.
        points: the multi-view edges.
        surface: their surface vectors, scores and probabilities.
        stats: counts and iterations.
    """

    disparity: Float[Array, "y x"]
    confidence: Float[Array, "y x"]
    depth_edge: Float[Array, "y x"]
    points: EdgePoints
    surface: SurfaceVectors
    stats: DepthStats


class _Labels(NamedTuple):
    """Labels and data weights per pixel."""

    weight: Array
    value: Array


@eqx.filter_jit
def edge_to_depth(params: Parameters, light_field: LightField, sizes: Sizes) -> DepthResult:
    """Estimates the disparity of every pixel of the centre view.

    0. Brightness and noise are measured once: gains of the views, again along the first map, are
       taken out; noise above that of 8 bits has the guide denoised, views blurred, costs pooled
       and points weigh less.
    1. Multi-view edges give precise disparities at image edges (Thesis 4.1).
    2. Hypotheses: per pixel, the disparity at which the unhidden half of either arm agrees best,
       along paths through the image where the pixel alone does not tell.
    3. Bidirectional diffusion and what surrounds each edge give its surface vector, which
       moves the label onto the surface that it was measured on (4.2.2).
    4. Diffusion (6.1), repeated, between labels weighted by their standard errors: those of the
       edges, and one per pixel measured in the views around the previous map, occluded views left
       out. Smoothness ends where a colour step and a depth step of that map meet.
    5. A weighted median moves blurred depth steps onto colour steps; more solves follow.

    Every light-field shape and every `sizes` is a program of its own, of some 2400 memory maps. A
    process that compiles more than about 25 should call `jax.clear_caches()` now and then: Linux
    allows 65530 maps, beyond which the compiler crashes.

    Args:
        params: see `Parameters`.
        light_field: the crosshair of views is read; ground truth is not.
        sizes: see `Sizes.for_light_field`.

    Returns:
        Disparity, confidence, points, statistics. Differentiable in the views and in every leaf
        of `params` at the selections made: points, hypotheses, sides, pixels that the median
        moved.

    Raises:
        ValueError: the light field has a single view per arm.

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
    step = params.edges.step
    low = (sizes.edges.first + 1) * step
    high = (sizes.edges.first + sizes.edges.filters - 2) * step
    tried = low + (high - low) * jnp.linspace(0, 1, sizes.hypotheses, dtype=dtype)

    exposure = rough_exposure(light_field)
    exposed = expose(light_field, exposure)
    centre = jnp.moveaxis(exposed.centre_view, -1, 0)
    arms = crosshair(exposed)
    noise = measure_noise(centre, exposure.scale, arms=arms, disparities=tried)
    guide = denoised(centre, noise)
    gray = srgb_to_gray(jnp.moveaxis(guide, 0, -1))
    shape = (gray.shape[0], gray.shape[1])
    lab = jnp.moveaxis(srgb_to_lab(jnp.moveaxis(guide, 0, -1)), -1, 0)
    first = None
    if sizes.dense:
        sigma = jnp.clip(0.4 + 30 * noise.deviation, 0.5, 1.0)
        soft, _ = low_pass(arms, noise, sigma)
        first = hypotheses(*soft, lab, tried, params.volume, noise=noise, window=sizes.window)
        # The gains again, now that it is known what shows the same.
        exposure = exposure_along(light_field, exposure.scale, first)
        exposed = expose(light_field, exposure)
        arms, kept = low_pass(crosshair(exposed), noise, jnp.minimum(30 * noise.deviation, 1))
        floor = jnp.maximum(jnp.sqrt(kept) * noise.deviation, params.photometric.noise)
        # Points take their disparity from few pixels, which noise leaves little of.
        params = eqx.tree_at(
            lambda p: (p.photometric.noise, p.centre.points),
            params,
            (floor, params.centre.points * (1 - noise.alpha)),
        )
    horizontal, vertical = arms
    edges = exposed_edges(exposed, exposure.scale, noise, params.edges, sizes.edges)
    points = edges.points
    passes = bidirectional(points, gray, params.bidirectional, normalised=sizes.side == "thesis")
    surface = _sides(points, passes, first, horizontal, vertical, params, sizes, shape)
    from_points, hits = _point_labels(points, surface, passes, params, sizes, shape)

    splines = _splines(horizontal), _splines(vertical)
    start = 0.5 * (passes.forward + passes.backward) if first is None else first

    def sharper(disparity: Array) -> Array:
        moved = sharpen(
            disparity,
            guide,
            params.median,
            radius=sizes.median_radius,
            levels=sizes.levels,
            mode=sizes.sharpening,
        )
        if not sizes.dense:
            return moved

        def mismatch(candidate: Array) -> Array:
            measured = photometric_labels(
                splines[0],
                splines[1],
                candidate,
                params.photometric,
                radius=sizes.radius,
                passes=sizes.passes,
            )
            return measured.residual

        before, after = lax.stop_gradient(lax.map(mismatch, jnp.stack([disparity, moved])))
        slack = params.centre.worse
        allowed = slack * (before + 2 * params.photometric.noise**2)
        return jnp.where(after <= allowed, moved, disparity)

    def solve(disparity: Array, turn: Array) -> tuple[Array, tuple[Array, Array, Array]]:
        # Sharpening inside of the loop, at its turn, keeps the program small: one solver, not two.
        if sizes.dense and sizes.sharpening != "none":
            disparity = lax.cond(turn == sizes.solves, sharper, lambda d: d, disparity)
        labels = from_points
        if sizes.dense:
            labels = _with_dense(labels, splines, disparity, params, sizes)
        tx, ty = edge_smoothness(lab, _blur(disparity, params.centre.blur), params.smoothness)
        uniform = params.centre.smoothness
        system = System(labels.weight, labels.value, uniform * tx, uniform * ty)
        found = diffuse(system, start=disparity, solver=Solver(tolerance=params.centre.tolerance))
        return found.value, (labels.weight, found.stats.iterations, found.stats.converged)

    rounds = 2 if sizes.dense and sizes.sharpening != "none" else 1
    disparity, (weights, iterations, converged) = lax.scan(
        jax.checkpoint(solve), start, jnp.arange(rounds * sizes.solves)
    )
    if not sizes.dense:
        disparity = sharper(disparity)
    stats = DepthStats(
        edges.stats,
        jnp.sum(hits),
        jnp.sum(points.valid & (surface.score != 0)),
        jnp.concatenate([passes.iterations, iterations]),
        jnp.all(converged),
        noise,
        exposure,
    )
    confidence = jnp.minimum(weights[-1], 1)
    return DepthResult(disparity, confidence, passes.edge, points, surface, stats)


def _splines(arm: Arm) -> Arm:
    return arm._replace(planes=spline_coefficients(arm.planes, axis=-1))


def _sides(
    points: EdgePoints,
    passes: Bidirectional,
    first: Array | None,
    horizontal: Arm,
    vertical: Arm,
    params: Parameters,
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
            points, passes.forward, passes.backward, horizontal, vertical, radius=sizes.radius
        )
    else:
        score = jnp.zeros_like(points.disparity)
    return choose(points, score, params.surface, relaxed=sizes.relaxed)


def _point_labels(
    points: EdgePoints,
    surface: SurfaceVectors,
    passes: Bidirectional,
    params: Parameters,
    sizes: Sizes,
    shape: tuple[int, int],
) -> tuple[_Labels, Array]:
    """The points' labels on their surfaces, and which pixels have one."""
    precise = _precision_weight(points.error**2, params.centre)
    if sizes.dense:
        weight = params.centre.points * precise
    else:
        # As in (6.3), scaled so that the strongest weight is 1.
        limit = jnp.exp(params.bidirectional.limit)
        weight = precise * (
            0.5 + 0.5 * point_weight(passes.confidence, points.valid, params.bidirectional) / limit
        )
    weight = jnp.where(points.valid, weight, 0)
    if not sizes.relaxed:
        raster = rasterise(points.xy + surface.offset, points.disparity, points.valid, shape)
        return _Labels(raster.values(weight), raster.values(points.disparity)), raster.hit
    shift = params.surface.offset * points.normal
    total, mean, hits = jnp.zeros(shape, weight.dtype), jnp.zeros(shape, weight.dtype), False
    for sign, share in ((1.0, surface.forward), (-1.0, 1 - surface.forward)):
        raster = rasterise(points.xy + sign * shift, points.disparity, points.valid, shape)
        part = raster.values(weight * share)
        total, mean = total + part, mean + part * raster.values(points.disparity)
        hits = hits | raster.hit
    return _Labels(total, mean / jnp.where(total > 0, total, 1)), jnp.asarray(hits)


def _with_dense(
    labels: _Labels, splines: tuple[Arm, Arm], disparity: Array, params: Parameters, sizes: Sizes
) -> _Labels:
    """Labels of the points together with one measured at every pixel."""
    measured = photometric_labels(
        splines[0],
        splines[1],
        disparity,
        params.photometric,
        radius=sizes.radius,
        passes=sizes.passes,
    )
    floor = params.photometric.noise**2
    excess = jnp.maximum(measured.residual, floor) / (params.centre.trust * floor)
    weight = _precision_weight(measured.variance, params.centre) / (1 + excess**2)
    distance = (labels.value - disparity) / params.centre.agreement
    sparse = labels.weight / (1 + distance**2) ** 2
    anchor = params.centre.anchor
    total = weight + sparse + anchor
    sums = weight * measured.disparity + sparse * labels.value + anchor * disparity
    return _Labels(total, sums / jnp.maximum(total, jnp.finfo(total.dtype).tiny))


def _precision_weight(variance: Array, params: CentreParams) -> Array:
    precision = params.precision**2
    return precision / (precision + variance)


def _blur(image: Float[Array, "y x"], sigma: Float[Array, ""]) -> Float[Array, "y x"]:
    """Gaussian of 5 x 5 taps, borders repeated."""
    taps = jax.nn.softmax(-0.5 * (jnp.arange(-2, 3, dtype=image.dtype) / sigma) ** 2)
    height, width = image.shape
    tall = jnp.pad(image, ((2, 2), (0, 0)), mode="edge")
    image = sum((taps[i] * tall[i : i + height] for i in range(1, 5)), taps[0] * tall[:height])
    wide = jnp.pad(image, ((0, 0), (2, 2)), mode="edge")
    return sum((taps[i] * wide[:, i : i + width] for i in range(1, 5)), taps[0] * wide[:, :width])
