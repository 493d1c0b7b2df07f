"""The chain in steps, for images that are read in parts; `tiles` runs them.

Steps that look at surroundings take a part of the image, those that diffuse take the whole. Each
is one compiled program, and their sequence is `estimate_depth`. Not differentiable.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from mvedge_jax._checks import checked_jit
from mvedge_jax._compiler import lean_jit
from mvedge_jax._params import cast
from mvedge_jax.lightfield import LightField

from ._diffused import diffused
from ._edge_depth import EdgeDepth, chain_in_halves, validate
from ._halves import Labeled as Labeled, diffuse_labels, find_labels, result_of
from ._labels import Labels
from ._measured_map import Turn as Turn, measured_labels, turns_by_solve as turns_by_solve
from ._refine import Given, Map as Map, Parts, cut_edges, labeled_share
from ._result import DepthResult


class Measured(NamedTuple):
    """What a diffusion reads; all `[y, x]`.

    Attributes:
        start: the map so far, px.
        labels: labels of every pixel.
        right: smoothness of the edge to the right.
        down: smoothness of the edge downwards.
    """

    start: Array
    labels: Labels
    right: Array
    down: Array


def _parts(model: EdgeDepth, start: Array) -> Parts:
    return cast(Parts(model.dense, model.smoothness, model.solver, model.refine), start.dtype)


@checked_jit(validate)
def label_part(
    light_field: LightField, model: EdgeDepth, *, key: PRNGKeyArray | None = None
) -> Labeled:
    """Labels of the points, the first map and prepared views.

    Args:
        light_field: the part of an image.
        model: the chain.
        key: of parts that draw.

    Returns:
        What the other steps read.
    """
    return find_labels(*chain_in_halves(light_field, model, key=key)[0])


@lean_jit
def measure_part(
    given: Given, disparity: Float[Array, "y x"], model: EdgeDepth, turns: Turn
) -> Measured:
    """Dense labels around a map, which is sharpened first where `turns` say so.

    Args:
        given: of that part, see `label_part`.
        disparity: that part of the map so far.
        model: the chain.
        turns: see `turns_by_solve`.

    Returns:
        What the next diffusion reads. The smoothness of edges out of the part is 0.
    """
    parts = _parts(model, disparity)
    start, labels = measured_labels(given, disparity, turns, parts)
    right, down = cut_edges(given, start, parts.smoothness)
    right, down = jnp.pad(right, ((0, 0), (0, 1))), jnp.pad(down, ((0, 1), (0, 0)))
    return Measured(start, labels, right, down)


@lean_jit
def diffuse_measured(
    measured: Measured, model: EdgeDepth, span: Float[Array, ""], turns: Turn
) -> Map:
    """Diffuses dense labels.

    Args:
        measured: of the whole image.
        model: the chain.
        span: see `Given`.
        turns: see `turns_by_solve`.

    Returns:
        The map; the error is 0 before the last turn.
    """
    start, labels, right, down = measured
    parts = _parts(model, start)
    (disparity, error), (iterations, converged) = diffused(
        labels,
        (right[:, :-1], down[:-1]),
        start,
        span,
        parts.refine,
        parts.solver,
        sloped=turns.sloped[-1],
        last=turns.last[-1],
    )
    share = labeled_share(labels, parts.refine)
    return Map(disparity, error, iterations, converged, share)


@lean_jit
def diffuse_points(labeled: Labeled, model: EdgeDepth) -> DepthResult:
    """Diffuses the labels of points alone.

    Args:
        labeled: of the whole image.
        model: the chain, without dense labels.

    Returns:
        See `DepthResult`.
    """
    return diffuse_labels(labeled, _parts(model, labeled.first))


@lean_jit
def finish(found: Map, labeled: Labeled, model: EdgeDepth) -> DepthResult:
    """Outlines, standard errors and statistics of a map.

    Args:
        found: of the whole image.
        labeled: of the whole image.
        model: the chain.

    Returns:
        See `DepthResult`.
    """
    return result_of(found, labeled, _parts(model, labeled.first))
