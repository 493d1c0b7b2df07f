"""Slopes of the map, so that weakly labelled walls are filled slanted instead of flat."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax.diffusion import Solver, System, diffuse


def rises(
    disparity: Float[Array, "y x"],
    weight: Float[Array, "y x"],
    edges: tuple[Float[Array, "y x-1"], Float[Array, "y-1 x"]],
    *,
    stiffness: Float[Array, ""],
    steepest: Float[Array, ""],
    flat: Float[Array, ""],
    tolerance: Float[Array, ""],
) -> tuple[Float[Array, "y x-1"], Float[Array, "y-1 x"]]:
    r"""What neighbouring pixels should differ by: the slope of the surface around them.

    Membranes bend nothing: where labels are weak they flatten a slanted wall. Differences of the
    map are therefore diffused along uncut edges themselves, weighted by how well both pixels are
    known, and the next solve asks for these differences instead of for none.

    Args:
        disparity: a map, px per view step, `[y, x]`.
        weight: of the labels that it was made from, `[y, x]`.
        edges: smoothness between neighbours, in [0, 1], `tx` and `ty`.
        stiffness: weight of an uncut edge between slopes against a perfectly known one.
        steepest: differences beyond this, px per px, are steps rather than slopes.
        flat: weight of the slope 0, against a perfectly known one.
        tolerance: where the solves stop, share of the range of the slopes.

    Returns:
        Right minus left and lower minus upper neighbour, px, as `diffusion.System` takes them.
        Differentiable.

    Source: not in the thesis; one round of alternating solves for a map and its slopes.
    """
    known = [_known(disparity, weight, edges, steepest, axis) for axis in (1, 0)]
    held = jnp.stack([total for total, _ in known]) + flat
    sums = jnp.stack([total for _, total in known])

    @jax.checkpoint
    def smooth(known: tuple[Array, Array]) -> Array:
        weight, label = known
        system = System(weight, label, stiffness * edges[0], stiffness * edges[1])
        return diffuse(system, solver=Solver(tolerance=tolerance)).value

    slope_x, slope_y = lax.map(smooth, (held, sums / held))
    return 0.5 * (slope_x[:, 1:] + slope_x[:, :-1]), 0.5 * (slope_y[1:] + slope_y[:-1])


def _known(
    disparity: Array,
    weight: Array,
    edges: tuple[Array, Array],
    steepest: Array,
    axis: int,
) -> tuple[Array, Array]:
    """What is known of the slope along an axis at every pixel: weight, and weight times slope."""
    size = disparity.shape[axis]
    start, end = (lax.slice_in_dim(weight, i, i + size - 1, axis=axis) for i in (0, 1))
    rise = jnp.diff(disparity, axis=axis)
    both = start * end / jnp.maximum(start + end, jnp.finfo(weight.dtype).tiny)
    # A cut edge tells nothing about the slope of either surface.
    share = edges[1 - axis] ** 2 * both / (1 + (rise / steepest) ** 4)
    return _ends(share, axis), _ends(share * rise, axis)


def _ends(values: Array, axis: int) -> Array:
    """Sum over the two edges of every pixel along an axis."""
    before, after = [(0, 0), (0, 0)], [(0, 0), (0, 0)]
    before[axis], after[axis] = (1, 0), (0, 1)
    return jnp.pad(values, before) + jnp.pad(values, after)
