"""Depth of a photograph from sparse points, diffused and optimized as in the thesis (7.2.2)."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from mvedge_jax._compiler import lean_jit
from mvedge_jax._params import as_number, at_least
from mvedge_jax._product import product
from mvedge_jax.color import srgb_to_gray
from mvedge_jax.losses import LossWeights
from mvedge_jax.model import DepthModel, Renderer, Start, render_model, start_from_image
from mvedge_jax.model.objectives import unlimited
from mvedge_jax.model.optimization import Progress, Rates, Routine, begin, one_at_a_time, optimize

from ._photographs import Photographs
from ._reference import Reference
from .objective import PosedReprojection

# Slopes below this share of the steepest one are not edges.
_FAINT = 0.05


class SeenPoints(NamedTuple):
    """Sparse points projected into a photograph.

    Attributes:
        xy: positions, px, `[m, 2]`.
        disparity: px per baseline, see `Reference`.
        valid: whether the photograph shows them; the others lie at the origin.
    """

    xy: Float[Array, "m 2"]
    disparity: Float[Array, " m"]
    valid: Bool[Array, " m"]


def seen_points(photographs: Photographs, reference: Reference) -> SeenPoints:
    """Projects the sparse points into a photograph.

    Args:
        photographs: with points.
        reference: see `reference_of`.

    Returns:
        All points. Valid are those in front of the camera and within its frame; if observations
        are known, only those that the photograph observed. Differentiable in points, poses and
        intrinsics.

    Raises:
        ValueError: there are no points.

    Example:
        >>> poses = jnp.stack([jnp.eye(4), jnp.eye(4).at[0, 3].set(0.4)])
        >>> matrix = jnp.asarray([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]])
        >>> points = jnp.asarray([[0.1, 0.0, 2.0], [0.0, 0.0, -1.0]])
        >>> pair = Photographs(jnp.zeros((2, 12, 16, 3)), poses, matrix, points=points)
        >>> from mvedge_jax.posed import reference_of
        >>> seen = seen_points(pair, reference_of(pair, 0, depth_range=(1.0, 4.0)))
        >>> seen.xy[0].tolist(), seen.valid.tolist()
        ([8.5, 5.5], [True, False])
    """
    if photographs.points is None:
        raise ValueError("`photographs` have no sparse points, which this method starts from.")
    index = reference.index
    pose, matrix = photographs.poses[index], photographs.intrinsics[index]
    local = product(photographs.points - pose[None, :3, 3], pose[:3, :3])
    ahead = local[:, 2] > 0
    depth = jnp.where(ahead, local[:, 2], 1)
    xy = product(local / depth[:, None], matrix.T)[:, :2]
    height, width = photographs.images.shape[1:3]
    edge = jnp.asarray([width - 0.5, height - 0.5], xy.dtype)
    valid = ahead & jnp.all((xy >= -0.5) & (xy <= edge[None]), axis=1)
    if photographs.observed is not None:
        saw = photographs.observed[index]
        valid = valid & (saw | ~jnp.any(saw))
    xy = jnp.where(valid[:, None], xy, 0)
    return SeenPoints(xy, jnp.where(valid, reference.scale(photographs) / depth, 0), valid)


def _weights() -> LossWeights:
    """The thesis' weights for multi-view stereo."""
    return LossWeights(smoothness=as_number(0.0075), dissimilarity=as_number(0.05))


class SparseStereoDepth(eqx.Module):
    """Parameters of `sparse_stereo`.

    Attributes:
        renderer: renders points to a map.
        weights: of the terms of the loss (7.16).
        rates: learning rates.
        smoothing: iterations of the smoothness alone, before points are added.
        extra: points added at the image's edges, per sparse point.
        iterations: number of iterations per parameter and pass.
        passes: number of passes over all parameters in turns.
    """

    renderer: Renderer = eqx.field(default_factory=Renderer)
    weights: LossWeights = eqx.field(default_factory=_weights)
    rates: Rates = eqx.field(default_factory=Rates)
    smoothing: int = eqx.field(static=True, default=50)
    extra: int = eqx.field(static=True, default=3)
    iterations: int = eqx.field(static=True, default=25)
    passes: int = eqx.field(static=True, default=5)

    def __check_init__(self) -> None:
        at_least(self, smoothing=1, extra=0, iterations=1, passes=0)


class SparseStereo(NamedTuple):
    """Depth of a photograph from points.

    Attributes:
        depth: distance along the optical axis, in the unit of the poses, `[y, x]`.
        disparity: px per baseline, `[y, x]`.
        diffused: disparity of the points, diffused without optimization.
        model: points and smoothness with the lowest loss.
        loss: per iteration after points were added.
    """

    depth: Float[Array, "y x"]
    disparity: Float[Array, "y x"]
    diffused: Float[Array, "y x"]
    model: DepthModel
    loss: Float[Array, " i"]


def sparse_stereo(
    photographs: Photographs,
    reference: Reference,
    method: SparseStereoDepth,
    *,
    progress: Callable[[Progress], None] | None = None,
    key: PRNGKeyArray,
) -> SparseStereo:
    """The thesis' multi-view stereo: points, diffused and optimized to explain the photographs.

    First the points are diffused and the smoothness is optimized alone. Then the map is sampled at
    image edges, and with these points added all parameters are optimized in turns. Runs on the
    host, in compiled pieces.

    Args:
        photographs: two or more, with sparse points.
        reference: see `reference_of`.
        method: see `SparseStereoDepth`.
        progress: called with the progress of the optimization in turns.
        key: random key of the edge pixels at which points are added.

    Returns:
        Depth and model. Not differentiable: each iteration is a step along the gradient of
        `PosedReprojection`, which is, in points, poses and images too.

    Raises:
        ValueError: there are no points, or none that the photograph shows.

    Source: Thesis 7.2.2; the point splats are narrower, see `SplatLabels.on_raster`, and on
        the photograph's own raster.
    """
    seen = seen_points(photographs, reference)
    if not bool(jnp.any(seen.valid)):
        raise ValueError("`photographs` have no sparse point that the reference shows.")
    image = photographs.images[reference.index]
    model = _model_of(seen, image)
    goal = posed_reprojection(photographs, reference, model, method)
    render = lean_jit(render_model)
    first = render(model, goal.renderer).disparity
    rates = jnp.zeros((method.smoothing, 4)).at[:, 0].set(method.rates.rate[0])
    routine = Routine(rates, jnp.zeros(method.smoothing, bool))
    smooth, _ = optimize(begin(model, first, key=key), routine, goal)
    between = render(smooth.best, goal.renderer, start=smooth.disparity).disparity
    # Equally many slots for every photograph, so that one program serves all.
    count = method.extra * seen.valid.size
    most = method.extra * jnp.sum(seen.valid)
    model = _with_edges(smooth.best, image, between, most, count=count, key=key)
    goal = eqx.tree_at(lambda g: g.trust, goal, unlimited(model))
    routine = one_at_a_time(method.rates, iterations=method.iterations, passes=method.passes)
    final, history = optimize(begin(model, between, key=key), routine, goal, progress=progress)
    disparity = render(final.best, goal.renderer, start=final.disparity).disparity
    least = 1e-6 * jnp.max(jnp.abs(reference.disparity_range)).astype(disparity.dtype)
    depth = reference.scale(photographs) / jnp.maximum(disparity, least)
    return SparseStereo(depth, disparity, first, final.best, history.loss)


def posed_reprojection(
    photographs: Photographs, reference: Reference, model: DepthModel, method: SparseStereoDepth
) -> PosedReprojection:
    """The objective of a model of a photograph.

    Args:
        photographs: two or more.
        reference: see `reference_of`.
        model: at the start; only smoothness and weights are limited.
        method: its `renderer` and `weights` are read.

    Returns:
        The objective. Differentiable in images, poses and intrinsics.
    """
    views = reference.views(photographs)
    return PosedReprojection(views, unlimited(model), method.renderer, method.weights)


def _model_of(seen: SeenPoints, image: Float[Array, "y x c"]) -> DepthModel:
    """Points of weight 1; rough where the image is."""
    one, flat = jnp.ones_like(seen.disparity), jnp.zeros_like(image[..., 0])
    model = DepthModel(seen.disparity, seen.xy, 0 * one, flat, seen.valid)
    return start_from_image(Start(model, one, flat), image).model


def _with_edges(
    model: DepthModel,
    image: Float[Array, "y x c"],
    disparity: Float[Array, "y x"],
    most: Int[Array, ""],
    *,
    count: int,
    key: PRNGKeyArray,
) -> DepthModel:
    """The model with points sampled from the map at random edge pixels of the image.

    At most `most` points are added, in `count` slots, or as many as there are pixels.
    """
    edge = _edges(image).reshape(-1)
    count = min(count, edge.size)
    lot, place = lax.top_k(jnp.where(edge, jax.random.uniform(key, edge.shape), -1), count)
    label, width = disparity.reshape(-1)[place], image.shape[1]
    xy = jnp.stack([place % width, place // width], axis=1).astype(label.dtype)
    return DepthModel(
        jnp.concatenate([model.disparity, label]),
        jnp.concatenate([model.xy, xy]),
        jnp.concatenate([model.log_weight, jnp.zeros_like(label)]),
        model.roughness,
        jnp.concatenate([model.valid, (lot >= 0) & (jnp.arange(count) < most)]),
    )


def _edges(image: Float[Array, "y x c"]) -> Bool[Array, "y x"]:
    """Pixels at which the slope of the gray image is largest along its direction."""
    gray = jnp.pad(srgb_to_gray(image), 1, mode="edge")
    across, down = gray[1:-1, 2:] - gray[1:-1, :-2], gray[2:, 1:-1] - gray[:-2, 1:-1]
    slope = across**2 + down**2
    sides = jnp.pad(slope, 1)
    row = (slope > sides[1:-1, :-2]) & (slope >= sides[1:-1, 2:])
    column = (slope > sides[:-2, 1:-1]) & (slope >= sides[2:, 1:-1])
    crest = jnp.where(jnp.abs(across) > jnp.abs(down), row, column)
    return crest & (slope > _FAINT**2 * jnp.max(slope))
