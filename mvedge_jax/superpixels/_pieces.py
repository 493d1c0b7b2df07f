"""Connected pieces of one surface; small ones join a neighbor."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax.image import components

from ._clustering import SuperpixelClustering
from ._clusters import Surface, shifted

# Largest number of rounds in which small pieces join others, which may be small, too.
_JOINS = 6


class Pieces(NamedTuple):
    """Connected pieces of the center view, whose number `root` has for every pixel.

    `sums` are of ones, colors and disparities over the pixels of each piece.
    """

    sums: Float[Array, "n 5"]
    root: Int[Array, "y x"]


def joined(
    surface: Surface, labels: Int[Array, "y x"], size: Float[Array, ""], model: SuperpixelClustering
) -> Pieces:
    """Splits labels into connected pieces of one surface, and joins small pieces to neighbors.

    Pieces with less than `model.smallest` of `size` squared are small. Pieces of different surfaces
    are separate unless one is a speck.
    """
    right, down = surface.links[0], surface.links[1]
    root = components(
        right & (labels == shifted(labels, 0, 1, -1)), down & (labels == shifted(labels, 1, 0, -1))
    )
    count = labels.size
    color = surface.lab / model.color
    depth = jnp.clip(surface.disparity / model.depth, -1e4, 1e4)
    features = jnp.concatenate([jnp.ones_like(depth)[..., None], color, depth[..., None]], -1)
    sums = jnp.zeros((count, 5), depth.dtype)
    sums = sums.at[root.ravel()].add(features.reshape(-1, 5), mode="promise_in_bounds")
    least = model.smallest * size**2
    pieces, every = Pieces(sums, root), jnp.ones_like(right)
    for along, below, limit in ((right, down, least), (every, every, model.speck)):

        def join(pieces: Pieces, along=along, below=below, limit=limit) -> tuple[Pieces, Array]:
            return _join(pieces, along, below, pieces.sums[:, 0] < limit)

        pieces = _repeated(join, pieces)
    return pieces


def fewer(
    pieces: Pieces, surface: Surface, wanted: Float[Array, ""], most: Float[Array, ""]
) -> Pieces:
    """Joins the smallest pieces to neighbors on their surface until the target number is met.

    Pieces of `most` pixels and more stay, whatever the target.
    """
    right, down = surface.links[0], surface.links[1]

    def join(pieces: Pieces) -> tuple[Pieces, Array]:
        root, area = pieces.root, pieces.sums[:, 0]
        beside = jnp.zeros(area.size, bool)
        for links, offset in ((right, (0, 1)), (down, (1, 0))):
            other = shifted(root, *offset, -1)
            apart = (links & (other >= 0) & (other != root)).ravel()
            for end in (root, other):
                beside = beside.at[jnp.where(apart, end.ravel(), area.size)].set(True, mode="drop")
        excess = jnp.sum(area > 0, dtype=jnp.int32) - jnp.round(wanted).astype(jnp.int32)
        # By rank, not by area, so that of many equal pieces only the excess joins.
        order = jnp.argsort(jnp.where(beside, area, jnp.inf))
        first = jnp.arange(area.size, dtype=jnp.int32) < excess
        chosen = jnp.zeros(area.size, bool).at[order].set(first, unique_indices=True)
        return _join(pieces, right, down, chosen & beside & (area < most))

    return _repeated(join, pieces)


def _repeated(join: Callable[[Pieces], tuple[Pieces, Array]], pieces: Pieces) -> Pieces:
    """Joins until no piece is left to join, at most `_JOINS` times."""

    def again(state: tuple[Array, Pieces, Array]) -> tuple[Array, Pieces, Array]:
        return state[0] + 1, *join(state[1])

    def going(state: tuple[Array, Pieces, Array]) -> Array:
        return (state[0] < _JOINS) & state[2]

    start = jnp.asarray(0, jnp.int32), pieces, jnp.asarray(True)
    return lax.while_loop(going, again, start)[1]


def _join(
    pieces: Pieces, right: Bool[Array, "y x"], down: Bool[Array, "y x"], chosen: Bool[Array, " n"]
) -> tuple[Pieces, Array]:
    """Joins each chosen piece to the most similar larger neighbor; returns whether any joined."""
    sums, root = pieces
    count, area = sums.shape[0], sums[:, 0]
    mean = sums[:, 1:] / jnp.maximum(area, 1)[:, None]
    pairs = []
    for links, (dy, dx) in ((right, (0, 1)), (down, (1, 0))):
        other = shifted(root, dy, dx, -1)
        apart = links & (other >= 0) & (other != root)
        one, two = jnp.where(apart, root, 0).ravel(), jnp.where(apart, other, 0).ravel()
        pairs += [(one, two, apart.ravel()), (two, one, apart.ravel())]
    small, large, apart = (jnp.concatenate(parts) for parts in zip(*pairs, strict=True))
    # Only into larger pieces (equal ones by their number), which excludes cycles.
    grows = (area[large] > area[small]) | ((area[large] == area[small]) & (large < small))
    allowed = apart & chosen[small] & grows
    cost = jnp.where(allowed, jnp.sum((mean[small] - mean[large]) ** 2, axis=1), jnp.inf)
    place = jnp.where(allowed, small, count)
    best = jnp.full(count + 1, jnp.inf, cost.dtype).at[place].min(cost)
    nearest = jnp.where(allowed & (cost == best[place]), large, count)
    own = jnp.arange(count, dtype=jnp.int32)
    target = jnp.full(count + 1, count, jnp.int32).at[place].min(nearest)[:-1]
    target = jnp.where(target < count, target, own)
    # Chains end after doublings: a chain is shorter than 2**16 as areas grow along it.
    target = lax.fori_loop(0, 16, lambda _, t: t[t], target)
    joined = Pieces(jnp.zeros_like(sums).at[target].add(sums), target[root])
    return joined, jnp.any(allowed)


def numbered(root: Int[Array, "y x"], capacity: int) -> tuple[Int[Array, "y x"], Int[Array, ""]]:
    """Numbers pieces from 1 in the order of their first pixels, 0 beyond the capacity; how many."""
    there = jnp.zeros(root.size, jnp.int32).at[root.ravel()].set(1)
    rank = jnp.cumsum(there, dtype=jnp.int32)
    label = rank[root]
    return jnp.where(label <= capacity, label, 0), rank[-1]
