"""Depth of the centre view from edge points alone, as the thesis has it."""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._compiler import lean_jit
from mvedge_jax._crosshair import crosshair
from mvedge_jax._fence import recomputed, staged
from mvedge_jax._params import at_least, cast, number, one_of, positive
from mvedge_jax.color import srgb_to_gray, srgb_to_lab
from mvedge_jax.depth import MedianParams, Sharpening, SmoothnessParams, edge_smoothness, sharpen
from mvedge_jax.diffusion import AutoSolver, System, diffuse
from mvedge_jax.edges import EdgePoints, rasterise, scene_range
from mvedge_jax.edges.sides import (
    Bidirectional,
    BidirectionalParams,
    SurfaceParams,
    SurfaceVectors,
    bidirectional,
    choose,
    step_response,
    surface_vectors,
)
from mvedge_jax.image import gaussian
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import occluder_radius

from ._reprojection import reprojection_score

SideChoice = Literal["thesis", "bidirectional", "reprojection", "naive"]
# Standard deviation and reach, px, of the Gaussian that a map passes before its steps cut edges.
_BLUR, _BLUR_REACH = 0.5, 2


class SparseParams(eqx.Module):
    """Parameters of `sparse_depth`.

    Attributes:
        bidirectional: of the two directional solves (4.2.2).
        surface: of the choice of side; the thesis' own reads the length of the vectors only.
        smoothness: of the edge weights (6.1).
        median: of the sharpening (6.1).
        precision: standard error, px, at which a label counts half as much as a perfect one.
        stiffness: weight of an uncut edge between pixels against a perfect label.
        gain: of the step response in the exponent of the data weight (6.3), per px of disparity.
        limit: largest exponent; the thesis' weight is unbounded, which hurts.
    """

    bidirectional: BidirectionalParams = eqx.field(default_factory=BidirectionalParams)
    surface: SurfaceParams = eqx.field(default_factory=SurfaceParams)
    smoothness: SmoothnessParams = eqx.field(default_factory=SmoothnessParams)
    median: MedianParams = eqx.field(default_factory=MedianParams)
    precision: Float[Array, ""] = number(0.005, "px")
    stiffness: Float[Array, ""] = number(1.5, "perfect labels")
    gain: Float[Array, ""] = number(3.0, "1/px")
    limit: Float[Array, ""] = number(4.0)


@dataclass(frozen=True)
class SparseSizes:
    """Static sizes of `sparse_depth`; equal ones share a compiled program.

    Attributes:
        radius: how far occluders are looked for where sides are chosen by reprojection, px.
        side: how surface vectors are chosen. `"thesis"`: step response of the two directional
            solves, profiles stretched to [-1, 1] (4.2.2); `"bidirectional"`: that of
            `surface_vectors`; `"reprojection"`: the map that reprojects better (Tab. 6.2);
            `"naive"`: no surface vectors, labels stay on their edges (Fig. B.1).
        solves: diffusions, each with the edges that the map before it cuts.
        sharpening: see `sharpen`; the thesis has `"quantised"` with 256 levels, through which no
            derivative passes.
        median_radius: radius of the weighted median, px.
        levels: slices of the weighted median.
        tolerance: of the solves, as in `centre.Sizes`.
    """

    radius: int
    side: SideChoice = "thesis"
    solves: int = 2
    sharpening: Sharpening = "clip"
    median_radius: int = 7
    levels: int = 48
    tolerance: float = 1e-5

    def __post_init__(self) -> None:
        at_least(self, radius=1, solves=1, median_radius=1, levels=2)
        positive(self, "tolerance")
        one_of(self, side=get_args(SideChoice), sharpening=get_args(Sharpening))

    @staticmethod
    def for_light_field(light_field: LightField, **choices: Any) -> "SparseSizes":
        """Chooses sizes on the host from the shape and the disparity range of a light field.

        Args:
            light_field: its range is measured where it does not come with one.
            **choices: any field to set by hand, such as `side="reprojection"`.

        Returns:
            Sizes for `sparse_depth`.
        """
        low, high = scene_range(light_field)
        height, width = light_field.views.shape[2:4]
        radius = occluder_radius(high - low, max(light_field.centre), (height, width))
        return SparseSizes(**{"radius": radius, **choices})


class SparseDepth(NamedTuple):
    """The result of `sparse_depth`.

    Attributes:
        disparity: px per view step, larger is nearer, `[y, x]`.
        depth_edge: depth-edge confidence (Thesis, Section 4.3), px per px, `[y, x]`.
        points: the edge points.
        surface: their surface vectors.
        iterations: of the two directional diffusions and of every map, in order.
        converged: whether every diffusion of a map reached its tolerance.
    """

    disparity: Float[Array, "y x"]
    depth_edge: Float[Array, "y x"]
    points: EdgePoints
    surface: SurfaceVectors
    iterations: Int[Array, " solves"]
    converged: Bool[Array, ""]


@lean_jit
def sparse_depth(
    light_field: LightField, points: EdgePoints, params: SparseParams, sizes: SparseSizes
) -> SparseDepth:
    """Diffuses edge points, and nothing else, into a map of the centre view.

    The two directional solves tell on which side of its edge each label belongs (4.2.2) and how
    much it counts (6.3); a diffusion between the labels (6.1), again with edges cut where the
    first map has its steps, and a weighted median follow. Edge weights and median are those of
    `edge_to_depth`, which differ from the thesis'; views are compared as they are.

    Args:
        light_field: its centre view, and its crosshair where sides are chosen by reprojection.
        points: of `multiview_edges`, `thesis_edges` or elsewhere.
        params: see `SparseParams`.
        sizes: see `SparseSizes.for_light_field`.

    Returns:
        The map with what it was made from. Differentiable in views, points and parameters at the
        pixels and sides chosen.

    Source: Thesis 4.2.2 and 6.1.

    Example:
        >>> flat = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
        >>> points = EdgePoints(
        ...     *(jnp.ones((1, *n)) for n in ((2,), (), (), (), (2,))),
        ...     visible=jnp.ones((1, 6), bool),
        ...     valid=jnp.ones(1, bool),
        ... )
        >>> sizes = SparseSizes.for_light_field(flat)
        >>> sparse_depth(flat, points, SparseParams(), sizes).disparity[8, 8].round(3).item()
        1.0
    """
    centre = light_field.centre_view
    dtype, shape = centre.dtype, (centre.shape[0], centre.shape[1])
    params = cast(params, dtype)
    coarse = AutoSolver(tolerance=jnp.asarray(100 * sizes.tolerance, dtype))
    respond = thesis_response if sizes.side == "thesis" else step_response

    @staged
    def directed(points: EdgePoints, gray: Array, params: BidirectionalParams) -> Bidirectional:
        return bidirectional(points, gray, params, respond=respond, solver=coarse)

    passes = directed(points, srgb_to_gray(centre), params.bidirectional)
    surface = _sides(light_field, points, passes, params.surface, sizes)
    weight = point_weight(passes.confidence, points, params)
    raster = rasterise(points.xy + surface.offset, points.disparity, points.valid, shape)
    label = raster.values(points.disparity)
    lab = jnp.moveaxis(srgb_to_lab(centre), -1, 0)
    weight = raster.values(weight)

    @recomputed
    def solve(disparity: Array, _: None) -> tuple[Array, tuple[Array, Array]]:
        smooth = gaussian(disparity, jnp.asarray(_BLUR, dtype), _BLUR_REACH)
        tx, ty = edge_smoothness(lab, smooth, params.smoothness)
        system = System(weight, label, params.stiffness * tx, params.stiffness * ty)
        solver = AutoSolver(tolerance=jnp.asarray(sizes.tolerance, dtype), by_residual=True)
        found = diffuse(system, start=disparity, solver=solver)
        return found.value, (found.stats.iterations, found.stats.converged)

    start = 0.5 * (passes.forward + passes.backward)
    disparity, (iterations, converged) = lax.scan(solve, start, length=sizes.solves)
    disparity = sharpen(
        disparity,
        jnp.moveaxis(centre, -1, 0),
        params.median,
        radius=sizes.median_radius,
        levels=sizes.levels,
        mode=sizes.sharpening,
    )
    iterations = jnp.concatenate([passes.iterations, iterations])
    return SparseDepth(disparity, passes.edge, points, surface, iterations, jnp.all(converged))


def thesis_response(profile: Float[Array, "7 n"]) -> Float[Array, " n"]:
    """Answer of the thesis' step filter to depth profiles stretched to [-1, 1].

    Args:
        profile: samples at -3..3 px along the normal, any unit.

    Returns:
        4 for a clean step of any height, 0 for a flat profile. Differentiable as `step_response`.

    Source: Thesis 4.2.2.
    """
    low, high = (f(profile, axis=0, keepdims=True) for f in (jnp.min, jnp.max))
    flat = high - low < 1e-6
    stretched = jnp.where(flat, 0, 2 * (profile - low) / jnp.where(flat, 1, high - low) - 1)
    return step_response(stretched, taps=(-1.0, -1.0, 1.0, 1.0))


def point_weight(
    confidence: Float[Array, " n"], points: EdgePoints, params: SparseParams
) -> Float[Array, " n"]:
    r"""Data weights: from standard errors, and from the depth-edge confidence.

    $e^{\min(a \lambda_e, l)}$, scaled so that the largest weight is 1 and the least one half.

    Args:
        confidence: `Bidirectional.confidence`, px.
        points: their standard errors, and which are there.
        params: `gain` is $a$, `limit` $l$.

    Returns:
        Weights in [0, 1], 0 in slots without a point. Differentiable.

    Source: Thesis 6.1, Eq. 6.3; the standard errors are ours.
    """
    precision = params.precision**2
    precise = precision / (precision + points.error**2)
    exponent = jnp.minimum(params.gain * confidence, params.limit) - params.limit
    return jnp.where(points.valid, precise * 0.5 * (1 + jnp.exp(exponent)), 0)


def _sides(
    light_field: LightField,
    points: EdgePoints,
    passes: Bidirectional,
    params: SurfaceParams,
    sizes: SparseSizes,
) -> SurfaceVectors:
    """Surface vectors in the way that `sizes.side` names."""
    if sizes.side == "bidirectional":
        shape = (passes.edge.shape[0], passes.edge.shape[1])
        return surface_vectors(points, passes.response, None, params, shape=shape)
    score = jnp.zeros_like(points.disparity)
    if sizes.side == "thesis":
        score = passes.response
    if sizes.side == "reprojection":
        arms, maps = crosshair(light_field), (passes.forward, passes.backward)
        score = reprojection_score(points, *maps, *arms, radius=sizes.radius)
    return choose(points, score, params)
