"""Whether all views give the same surface the same label."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

# A view shows a surface where its true disparity is this close, px per view step.
_SAME = 0.1


class Agreement(NamedTuple):
    """Sums of one view, or of many, against the center view.

    Attributes:
        distance: between centroids, px, over labels, of what both views see.
        labels: that both have.
        seen: whether the view sees a pixel of the center view.
        differs: whether it sees it and gives it a label that is not around it.
    """

    distance: Float[Array, ""]
    labels: Int[Array, ""]
    seen: Int[Array, "y x"]
    differs: Int[Array, "y x"]


def _centroids(labels: Array, weight: Array, x: Array, y: Array, count: int) -> tuple[Array, ...]:
    """Mass and mean place per label."""
    values = jnp.stack([weight, weight * x, weight * y], axis=-1)
    sums = jnp.zeros((count, 3), values.dtype).at[labels].add(values, mode="promise_in_bounds")
    mass = jnp.where(sums[:, 0] > 0, sums[:, 0], 1)
    return sums[:, 0] > 0, sums[:, 1] / mass, sums[:, 2] / mass


def _apart(one: tuple[Array, ...], other: tuple[Array, ...]) -> tuple[Array, Array]:
    """Sum of the distances of labels that both have, 0 left out, and how many these are."""
    both = (one[0] & other[0]).at[0].set(False)
    distance = jnp.hypot(one[1] - other[1], one[2] - other[2])
    return jnp.sum(jnp.where(both, distance, 0)), jnp.sum(both, dtype=jnp.int32)


def _around(label: Array, labels: Array) -> Array:
    """Whether a label is among those of the 3x3 pixels around each."""
    height, width = labels.shape
    # -1 is no label: nothing beyond the frame agrees.
    padded = jnp.pad(labels, 1, constant_values=-1)
    found = jnp.zeros(labels.shape, bool)
    for dy in range(3):
        for dx in range(3):
            found = found | (padded[dy : dy + height, dx : dx + width] == label)
    return found


def agreement(
    labels: Int[Array, "v u y x"],
    disparity: Float[Array, "v u y x"],
    available: Bool[Array, "v u"],
    *,
    count: int,
) -> Agreement:
    """Compares the labels of every other view with those of the center view, by true disparities.

    Sums over the views that take part; `count` labels, 0 (none) included.
    """
    rows, columns, height, width = labels.shape
    vc, uc = rows // 2, columns // 2
    dtype = disparity.dtype
    center, depth = labels[vc, uc], disparity[vc, uc]
    x = jnp.broadcast_to(jnp.arange(width, dtype=dtype)[None], center.shape)
    y = jnp.broadcast_to(jnp.arange(height, dtype=dtype)[:, None], center.shape)

    def one(view: Array, truth: Array, step: Array, use: Array) -> Agreement:
        column, row = (
            jnp.floor(a + s * depth + 0.5).astype(jnp.int32)
            for a, s in ((x, step[0]), (y, step[1]))
        )
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        index = jnp.where(inside, row * width + column, 0)
        seen = use & inside & (jnp.abs(truth.ravel()[index] - depth) <= _SAME)
        label = view.ravel()[index]
        weight = seen.astype(dtype)
        apart = _apart(
            _centroids(center, weight, x, y, count), _centroids(label, weight, x, y, count)
        )
        differs = seen & ~(_around(label, center) & (label > 0))
        return Agreement(*apart, seen.astype(jnp.int32), differs.astype(jnp.int32))

    v, u = jnp.indices((rows, columns))
    steps = jnp.stack([uc - u, vc - v], axis=-1).reshape(-1, 2).astype(dtype)
    use = available.ravel() & jnp.any(steps != 0, axis=1)
    items = labels.reshape(-1, height, width), disparity.reshape(-1, height, width), steps, use

    def add(total: Agreement, item: tuple[Array, ...]) -> tuple[Agreement, None]:
        return jax.tree.map(jnp.add, total, one(*item)), None

    empty = jnp.zeros(center.shape, jnp.int32)
    start = Agreement(jnp.zeros((), dtype), jnp.zeros((), jnp.int32), empty, empty)
    return lax.scan(add, start, items)[0]
