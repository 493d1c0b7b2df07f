"""Slopes of the map, so that weakly labeled walls are filled slanted instead of flat."""

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._params import number
from mvedge_jax._root import LEAST_DIVISOR


class Slopes(eqx.Module):
    """How slopes of the map are diffused.

    Attributes:
        stiffness: weight of an uncut edge between slopes against a perfect label.
        steepest: differences of neighbors beyond this are steps rather than slopes.
        flat: weight of the slope 0 against that of a perfect label.
    """

    stiffness: Float[Array, ""] = number(30.0, "perfect labels")
    steepest: Float[Array, ""] = number(0.3, "px/px")
    flat: Float[Array, ""] = number(1e-4, "perfect labels")


def slope_labels(
    disparity: Float[Array, "y x"],
    weight: Float[Array, "y x"],
    edges: tuple[Float[Array, "y x-1"], Float[Array, "y-1 x"]],
    params: Slopes,
) -> tuple[Float[Array, "2 y x"], Float[Array, "2 y x"]]:
    """Labels of the slopes, from the differences of a map.

    A membrane flattens a slanted wall where labels are weak. So the differences of the map are
    diffused themselves, along uncut edges and weighted by the labels of both pixels, and the next
    solve prefers these differences (`rises`) to 0.

    Args:
        disparity: a map, px per view step, `[y, x]`.
        weight: weights of the labels of the map, `[y, x]`.
        edges: smoothness between neighbors, in [0, 1], `tx` and `ty`.
        params: see `Slopes`.

    Returns:
        Weights and labels of the slopes along x and along y, px per px. Differentiable.

    Source: not in the thesis; one round of alternating solves for a map and its slopes.
    """
    known = [_known(disparity, weight, edges, params.steepest, axis) for axis in (1, 0)]
    held = jnp.stack([total for total, _ in known]) + params.flat
    return held, jnp.stack([total for _, total in known]) / held


def rises(slopes: Float[Array, "2 y x"]) -> tuple[Float[Array, "y x-1"], Float[Array, "y-1 x"]]:
    """Preferred differences of neighboring pixels: the mean of their slopes.

    Args:
        slopes: along x and along y, px per px.

    Returns:
        Right minus left and lower minus upper neighbor, px, as `diffusion.System` takes them.
    """
    along_x, along_y = slopes
    return 0.5 * (along_x[:, 1:] + along_x[:, :-1]), 0.5 * (along_y[1:] + along_y[:-1])


def _known(
    disparity: Array,
    weight: Array,
    edges: tuple[Array, Array],
    steepest: Float[Array, ""],
    axis: int,
) -> tuple[Array, Array]:
    """Weight, and weight times slope, along an axis at every pixel."""
    size = disparity.shape[axis]
    start, end = (lax.slice_in_dim(weight, i, i + size - 1, axis=axis) for i in (0, 1))
    rise = jnp.diff(disparity, axis=axis)
    both = start * end / jnp.maximum(start + end, LEAST_DIVISOR)
    # A cut edge has no information about the slope of either surface.
    share = edges[1 - axis] ** 2 * both / (1 + (rise / steepest) ** 4)
    return _ends(share, axis), _ends(share * rise, axis)


def _ends(values: Array, axis: int) -> Array:
    """Sum over the two edges of every pixel along an axis."""
    before, after = [(0, 0), (0, 0)], [(0, 0), (0, 0)]
    before[axis], after[axis] = (1, 0), (0, 1)
    return jnp.pad(values, before) + jnp.pad(values, after)
