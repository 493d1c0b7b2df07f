"""From labels to a map: the diffusions of the chain."""

from typing import Any

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._checkpoint import checkpoint

from ._dense import LabelContext as LabelContext
from ._diffused import diffused
from ._labels import Labels as Labels, precision_weight as precision_weight
from ._learned import LearnedLabels as LearnedLabels
from ._measured_map import measured_map
from ._refine import Given as Given, Map as Map, Parts as Parts, cut_edges, labeled_share


def refine_disparity(given: Given, first: Float[Array, "y x"], parts: Parts) -> Map:
    """Repeated diffusion of labels, with slopes from the second solve on, and sharpening.

    Dense labels are measured again around every map, and a pixel follows the sharpened map only if
    the residual allows it. Without dense labels, those of the points are diffused `solves` times,
    each time with edges cut by the previous map, and the map is sharpened once.

    Args:
        given: see `Given`.
        first: initial disparity, px per view step.
        parts: parts of the chain.

    Returns:
        The map. Differentiable.
    """
    solve = measured_map if parts.dense is not None else _map_of_points
    return solve(given, first, parts)


def _map_of_points(given: Given, first: Array, parts: Parts) -> Map:
    count, sharpen = parts.refine.solves, parts.refine.sharpen

    def step(state: tuple[Array, Array], index: Array) -> tuple[tuple[Array, Array], Any]:
        disparity = state[0]
        return diffused(
            given.from_points,
            cut_edges(given, disparity, parts.smoothness),
            disparity,
            given.span,
            parts.refine,
            parts.solver,
            sloped=index > 0,
            last=index == count - 1,
        )

    start = (first, jnp.zeros_like(first))
    labeled = labeled_share(given.from_points, parts.refine)
    (disparity, error), (iterations, converged) = lax.scan(
        checkpoint(step), start, jnp.arange(count)
    )
    return Map(sharpen(disparity, given.guide), error, iterations, jnp.all(converged), labeled)
