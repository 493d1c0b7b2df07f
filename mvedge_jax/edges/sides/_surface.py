"""Surface vectors: the side of its edge that each label belongs to."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._params import accepts_numpy, cast, number
from mvedge_jax.image import nearest_pixels
from mvedge_jax.interpolation import exact_shift

from .._points import EdgePoints
from .._raster import rasterize
from ._evidence import map_evidence, neighbor_evidence


class SideVote(eqx.Module):
    """Weights of the evidence for either side.

    Attributes:
        offset: length of a surface vector, px.
        response: weight of the bidirectional response.
        neighbors: weight of the evidence from neighboring labels.
        dense: weight of the evidence from a dense map, where there is one.
        radius: standard deviation of the neighborhood of a label, px.
        cap: differences of disparity saturate here, px.
        temperature: temperature of the probabilities, px of evidence.
    """

    offset: Float[Array, ""] = number(1.0, "px")
    response: Float[Array, ""] = number(0.3)
    neighbors: Float[Array, ""] = number(1.0)
    dense: Float[Array, ""] = number(1.0)
    radius: Float[Array, ""] = number(6.0, "px")
    cap: Float[Array, ""] = number(0.3, "px")
    temperature: Float[Array, ""] = number(0.05, "px")


class SurfaceVectors(NamedTuple):
    """The choice per point.

    Attributes:
        score: positive speaks for `+normal`, px of evidence, `[n]`.
        forward: probability of `+normal`, `[n]`, one half without evidence.
        offset: surface vectors in px, `(x, y)`, `[n, 2]`, towards the more likely side.
        length: length of a surface vector, px.
    """

    score: Float[Array, " n"]
    forward: Float[Array, " n"]
    offset: Float[Array, "n 2"]
    length: Float[Array, ""]


@accepts_numpy
def surface_vectors(
    points: EdgePoints,
    response: Float[Array, " n"] | None,
    disparity: Float[Array, "y x"] | None,
    params: SideVote,
    *,
    shape: tuple[int, int],
    reach: int = 6,
) -> SurfaceVectors:
    """Combines the evidence for both sides of every edge and smooths it along the edge.

    Args:
        points: positions, disparities, unit normals.
        response: response of the bidirectional diffusion, px, `[n]`, or None.
        disparity: a dense map, or None.
        params: see `SideVote`.
        shape: rows and columns of the center view.
        reach: distance over which the score is averaged along the edge to either side, px.

    Returns:
        Scores, probabilities, vectors. The first two are differentiable; the choice of the more
        likely side is a selection.

    Source: Thesis 4.2.2.
    """
    params = cast(params, points.disparity.dtype)
    raster = rasterize(points.xy, points.disparity, points.valid, shape)
    score = params.neighbors * neighbor_evidence(
        points, raster, radius=params.radius, cap=params.cap
    )
    if response is not None:
        # Saturated like the other evidence, because the response is proportional to the step.
        bounded = params.cap * jnp.tanh(response / params.cap)
        score = score + params.response * bounded
    if disparity is not None:
        score = score + params.dense * map_evidence(points, disparity, cap=params.cap)
    score = along_edge(points, score, shape=shape, reach=reach)
    return choose(points, score, params)


@accepts_numpy
def choose(points: EdgePoints, score: Float[Array, " n"], params: SideVote) -> SurfaceVectors:
    """Turns scores into surface vectors along the normals.

    Probabilities are a logistic function of the score, which is positive if it speaks for
    `+normal`. Points that are not valid have offset 0 and probability one half.
    """
    params = cast(params, points.disparity.dtype)
    forward = jnp.where(points.valid, jax.nn.sigmoid(score / params.temperature), 0.5)
    sign = jnp.sign(lax.stop_gradient(score))
    offset = jnp.where(points.valid, params.offset * sign, 0)[:, None] * points.normal
    return SurfaceVectors(score, forward, exact_shift(offset), params.offset)


def along_edge(
    points: EdgePoints,
    score: Float[Array, " n"],
    *,
    shape: tuple[int, int],
    reach: int,
) -> Float[Array, " n"]:
    """Averages a score over the points up to `reach` px along the edge, with signs by the normals.

    Differentiable in `score` at the rasterization chosen.

    Source: Thesis 4.2.2 (regularization); a mean in place of the authors' walk along the edge.
    """
    if reach == 0:
        return score
    raster = rasterize(points.xy, points.disparity, points.valid, shape)
    index_map, count = raster.slot.reshape(-1), points.disparity.shape[0]
    padded_score = jnp.concatenate([score, jnp.zeros_like(score[:1])])
    padded_normal = jnp.concatenate([points.normal, jnp.zeros_like(points.normal[:1])])
    padded_disparity = jnp.concatenate([points.disparity, jnp.zeros_like(score[:1])])
    tangent = jnp.stack([-points.normal[:, 1], points.normal[:, 0]], -1)

    @jax.checkpoint
    def add(total: tuple[Array, Array], step: Array) -> tuple[tuple[Array, Array], None]:
        at = nearest_pixels(points.xy + exact_shift(step * tangent), shape)
        other = jnp.where(at.inside, index_map[at.places(shape[1])], count)
        turn = jnp.sum(padded_normal[other] * points.normal, -1)
        same = jnp.exp(-(((padded_disparity[other] - points.disparity) / 0.1) ** 2))
        weight = jnp.where(other < count, jnp.abs(turn) * same, 0)
        signed = jnp.sign(lax.stop_gradient(turn)) * padded_score[other]
        return (total[0] + weight * signed, total[1] + weight), None

    offsets = jnp.concatenate(
        [jnp.arange(-reach, 0, dtype=score.dtype), jnp.arange(1, reach + 1, dtype=score.dtype)]
    )
    # A point is its own neighbor, so that a lone point keeps its score.
    start = (score, jnp.ones_like(score))
    (total, weight), _ = lax.scan(add, start, offsets)
    return jnp.where(points.valid, total / weight, 0)
