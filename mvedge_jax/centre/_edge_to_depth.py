"""The whole chain: light field in, dense disparity of the centre view out."""

from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._checks import checked_jit, expect, sound, with_numbers
from mvedge_jax._fence import staged
from mvedge_jax._params import cast, readable
from mvedge_jax.color import srgb_to_gray
from mvedge_jax.diffusion import AutoSolver
from mvedge_jax.edges import EdgePoints, EdgeStats, measured_edges, share
from mvedge_jax.edges.sides import (
    BidirectionalParams,
    SurfaceParams,
    SurfaceVectors,
    bidirectional,
    surface_vectors,
)
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import Exposure, Noise, Scene, first_labels, prepare, sight
from mvedge_jax.warping import outline

from ._labels import AGREEMENT, Labels, precision_weight
from ._parameters import CentreParams, Parameters, Sizes, check_covers
from ._problems import problems
from ._sharpen import sharpen
from .error import standard_error
from .solves import Map, dense_map

# Log odds that the map has a pixel beside a step on the right side. From all 13 scenes, which would
# have less on the mean, but for cotton: silhouettes that are shaded darker than what is in front.
_PRIOR = 8.0


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
        sound: whether all parameters were finite and none negative; if not, the map is NaN.
        searched: lowest and highest disparity that was tried, px per view step.
    """

    edges: EdgeStats
    points: Int[Array, ""]
    sided: Int[Array, ""]
    iterations: Int[Array, " solves"]
    converged: Bool[Array, ""]
    noise: Noise
    exposure: Exposure
    sound: Bool[Array, ""]
    searched: Float[Array, "2"]

    def __repr__(self) -> str:
        return readable(self)


class DepthResult(NamedTuple):
    """Depth of the centre view, with what it was made from.

    Attributes:
        disparity: px per view step, larger is nearer, `[y, x]`.
        error: standard error of the disparity, px, `[y, x]`: of the labels that a pixel was made
            from, its own and, where these are weak, those of its surroundings, which far from any
            label give way to the spread of the whole map or, where little was measured at all, to
            the width of the range that was tried; and what half a pixel of doubt about the place of
            a depth step amounts to. Infinite if there is no label at all.
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

    def problems(self) -> tuple[str, ...]:
        """What the statistics say against the map, one sentence each; on the host."""
        return problems(self)

    def check(self) -> "DepthResult":
        """The same result, if there is nothing to say against it; on the host.

        Raises:
            RuntimeError: with the sentences of `problems`.
        """
        found = self.problems()
        if found:
            raise RuntimeError("The depth is not to be trusted: " + " ".join(found))
        return self


def _look(light_field: Any, params: Any, sizes: Any) -> tuple[Any, ...]:
    """The arguments of `edge_to_depth`, or what is wrong with them."""
    order = "the order is (light_field, params, sizes)"
    wrapped = "`LightField(views)` makes one of an array [v, u, y, x, c], and " + order
    expect("light_field", light_field, LightField, wrapped)
    expect("params", params, Parameters, "`Parameters()` has the defaults, and " + order)
    chosen = "`Sizes.for_light_field(light_field)` chooses them, and " + order
    expect("sizes", sizes, Sizes, chosen)
    check_covers(light_field, sizes)
    return (light_field.bare(), with_numbers(params), sizes), {}


@checked_jit(_look)
def edge_to_depth(light_field: LightField, params: Parameters, sizes: Sizes) -> DepthResult:
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
       out. Smoothness ends where a colour step and a depth step of that map meet. What the lens
       leaves dark along the frame has neither: it goes on with what is beside it.
    6. A weighted median moves blurred depth steps onto colour steps; more solves follow, the last
       two with labels from all views, if these are asked for.
    7. Pixels beside depth steps go to the surface that covers most of them (`warping.outline`).

    Every light-field shape and every `sizes` is a program of its own, of some 1300 memory maps, or
    2500 where `compiler_options` were not asked for. A process that compiles more than about 25
    should call `jax.clear_caches()` now and then: Linux allows 65530 maps, beyond which the
    compiler crashes.

    Args:
        light_field: the crosshair of views is read, or all of them (`Sizes.views`); ground truth is
            not.
        params: see `Parameters`.
        sizes: see `Sizes.for_light_field`.

    Returns:
        Disparity, standard error, points, statistics. Differentiable, forwards and backwards, in
        the views and in every leaf of `params` at the selections made: points, hypotheses, sides,
        levels of the median. A leaf that only selects is a threshold: its derivative is 0
        (`tests/centre/test_derivatives.py` lists them). In single precision the derivative of
        a single pixel is lost below 1e-38, and above 1e38 it is NaN: scale a loss that is smaller
        than 1e-10 or larger than 1e20. Rounding alone leaves single parameters' derivatives right
        to about 2e-4 there, as they are sums that cancel.

    Raises:
        ValueError: the light field has a single view per arm; or, outside `jit`, a parameter is not
            finite or is negative, or `sizes` were made for a narrower range than the light field's.
            Under `jit` such parameters give a map of NaN, and `stats.sound` is False.
        TypeError: an argument is of another kind, or their order is another.

    Source: Thesis 6.1, 4.2.2 and 4.3 (sections); what differs, and why, is a page of the
        documentation.

    Example:
        >>> import jax.numpy as jnp
        >>> flat = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
        >>> result = edge_to_depth(flat, Parameters(), Sizes.for_light_field(flat))
        >>> bool(jnp.isfinite(result.disparity).all())
        True
    """
    if max(light_field.views.shape[:2]) < 3:
        raise ValueError(
            "`light_field` must have at least three views in a row or in a column, got a grid of "
            f"{light_field.views.shape[0]}x{light_field.views.shape[1]}."
        )
    dtype = light_field.views.dtype
    every = light_field if sizes.views == "all" else None
    params = cast(params, dtype)
    fine = sound(params)
    turned = cast(params.bidirectional or BidirectionalParams(), dtype)
    sided = cast(params.surface or SurfaceParams(), dtype)

    # 1 and 2: brightness, noise, and what every pixel's own measurement says.
    disparities = sizes.edges.hypotheses(sizes.hypotheses, dtype)
    scene = prepare(
        light_field, disparities, params.volume, window=sizes.window, every=every is not None
    )
    ready = staged(lambda scene, params, every: sight(scene, params, every=every))
    views = ready(scene, params.photometric, every)
    measure = partial(first_labels, radius=sizes.radius, passes=sizes.passes)
    measured = staged(measure)(scene, views)

    # 3: edges.
    find = partial(measured_edges, sizes=sizes.edges, radius=sizes.radius)
    edges = staged(find)(scene, views, measured, params.edges)
    points, first = edges.points, measured.disparity

    # 4: their sides.
    gray = srgb_to_gray(jnp.moveaxis(scene.guide, 0, -1))
    coarse = AutoSolver(tolerance=jnp.asarray(100 * sizes.tolerance, dtype))
    passes = staged(partial(bidirectional, solver=coarse))(points, gray, turned)
    choose_side = partial(surface_vectors, shape=(gray.shape[0], gray.shape[1]))
    surface = staged(choose_side)(points, passes.response, first, sided)

    # 5 and 6: labels, diffused.
    from_points = _point_labels(points, surface, scene.noise, first, sided, params.centre)
    sharper = partial(
        sharpen,
        guide=scene.guide,
        params=params.median,
        radius=sizes.median_radius,
        levels=sizes.levels,
        mode=sizes.sharpening,
    )
    span = disparities[-1] - disparities[0]
    found = dense_map(
        from_points, views, scene.lab, first, span, sharper, params, sizes, lit=scene.lit
    )

    # 7: pixels of both surfaces.
    disparity, error = _outlined(found, scene, fine)
    stats = DepthStats(
        edges.stats,
        jnp.sum(from_points.weight > 0),
        jnp.sum(points.valid & (surface.score != 0)),
        jnp.concatenate([passes.iterations, found.iterations]),
        found.converged & fine,
        scene.noise,
        scene.exposure,
        fine,
        jnp.stack([disparities[0], disparities[-1]]),
    )
    return DepthResult(disparity, error, passes.edge, points, surface, stats)


def _point_labels(
    points: EdgePoints,
    surface: SurfaceVectors,
    noise: Noise,
    first: Float[Array, "y x"],
    sided: SurfaceParams,
    params: CentreParams,
) -> Labels:
    """The points' labels, on either side of their edges as far as it is likely to be theirs."""
    # Points take their disparity from few pixels, which noise leaves little of.
    trusted = params.points * (1 - noise.alpha) * points.confidence
    weight = trusted * precision_weight(points.error**2, params)
    weight = jnp.where(points.valid, weight, 0)
    agreement = jnp.asarray(AGREEMENT, weight.dtype)
    total, mean = jnp.zeros_like(first), jnp.zeros_like(first)
    shift = sided.offset * points.normal
    for sign, likely in ((1.0, surface.forward), (-1.0, 1 - surface.forward)):
        place = points.xy + sign * shift
        amount, value = share(place, points.disparity, weight * likely, first, agreement)
        total, mean = total + amount, mean + amount * value
    return Labels(total, mean / jnp.where(total > 0, total, 1))


def _outlined(
    found: Map, scene: Scene, fine: Bool[Array, ""]
) -> tuple[Float[Array, "y x"], Float[Array, "y x"]]:
    """Disparity and its standard error once pixels of two surfaces have one of them."""
    shown = outline(found.disparity, scene.guide, scene.noise.deviation, prior=_PRIOR)
    disparity, doubt = (jnp.ravel(a)[shown] for a in (found.disparity, found.error))
    # Selections drop NaN on the way: a parameter that is none would leave a plausible map.
    unknown = jnp.asarray(jnp.nan, disparity.dtype)
    error = standard_error(doubt, disparity)
    return jnp.where(fine, disparity, unknown), jnp.where(fine, error, unknown)
