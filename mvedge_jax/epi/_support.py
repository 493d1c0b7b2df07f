"""Support of a point by its neighbours: the vote that catches what photo-consistency misses."""

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

_REACH = 4


def neighbour_support(
    disparity: Float[Array, "y x"],
    present: Bool[Array, "y x"],
    weight: Float[Array, "y x"],
    radius: Float[Array, ""],
    tolerance: Float[Array, ""],
) -> Float[Array, "y x"]:
    """Share of the neighbours' votes, weighted by distance, that agree with a pixel's disparity.

    `sum_q w_q g(|q - p|) / (1 + ((d_q - d_p) / tolerance)^2) / sum_q w_q g(|q - p|)`, without the
    pixel itself, over a 9x9 window of pixels that carry a point. A smooth form of the spatial
    vote of Thesis 4.1.3 that needs no disparity bins.

    Args:
        disparity: px per view step, one point per pixel at most.
        present: which pixels carry a point that may vote.
        weight: a point's vote.
        radius: standard deviation of the distance weight, px.
        tolerance: disparity difference, px, that halves a vote.

    Returns:
        Values in [0, 1]; 0 without neighbours. Differentiable.
    """
    height, width = disparity.shape
    margin = ((_REACH, _REACH), (_REACH, _REACH))
    votes = jnp.pad(jnp.where(present, weight, 0), margin)
    labels = jnp.pad(disparity, margin)
    offsets = [
        (j, i)
        for j in range(2 * _REACH + 1)
        for i in range(2 * _REACH + 1)
        if (j, i) != (_REACH, _REACH)
    ]

    def add(
        carry: tuple[Array, Array], offset: Int[Array, "2"]
    ) -> tuple[tuple[Array, Array], None]:
        agree, total = carry
        distance = ((offset - _REACH).astype(disparity.dtype) ** 2).sum()
        near = jnp.exp(-0.5 * distance / radius**2)
        vote = near * lax.dynamic_slice(votes, (offset[0], offset[1]), (height, width))
        label = lax.dynamic_slice(labels, (offset[0], offset[1]), (height, width))
        share = 1 / (1 + ((label - disparity) / tolerance) ** 2)
        return (agree + vote * share, total + vote), None

    nothing = jnp.zeros_like(disparity)
    (agree, total), _ = lax.scan(add, (nothing, nothing), jnp.asarray(np.array(offsets), jnp.int32))
    return jnp.where(total > 1e-6, agree / jnp.where(total > 1e-6, total, 1), 0)


def frontmost(
    slot: Int[Array, "y x"], values: Float[Array, " n"]
) -> tuple[Int[Array, "y x"], Float[Array, "y x"]]:
    """The slot of the largest value within 5x5 pixels, and that value; -inf where there is none.

    Comparing slots keeps the value differentiable; a maximum over windows is not, twice.
    """
    nobody = values.shape[0]
    known = jnp.append(lax.stop_gradient(values), -jnp.inf)
    best = known[slot]
    for axis in (0, 1):
        margin = [(0, 0), (0, 0)]
        margin[axis] = (2, 2)
        slots = jnp.pad(slot, margin, constant_values=nobody)
        values_there = jnp.pad(best, margin, constant_values=-jnp.inf)
        size = slot.shape[axis]
        for offset in (0, 1, 3, 4):
            other = lax.slice_in_dim(values_there, offset, offset + size, axis=axis)
            index = lax.slice_in_dim(slots, offset, offset + size, axis=axis)
            wins = other > best
            slot, best = jnp.where(wins, index, slot), jnp.where(wins, other, best)
    return slot, best
