"""Superpixels of one view against objects, and their shape."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax.image import components, highest

# Boundaries this far apart, px along either axis, are the same.
_REACH = 2


class Overlap(NamedTuple):
    """What a table of pixels per superpixel and object says about one view.

    Attributes:
        objects: (5.3) of the view.
        area: leaks over the view's pixels, of both objects that a superpixel lies on.
        once: the same, each leak once.
    """

    objects: Float[Array, ""]
    area: Float[Array, ""]
    once: Float[Array, ""]


class Shape(NamedTuple):
    """The superpixels of one view.

    Attributes:
        compactness: (5.4) with the sides of pixels as perimeter.
        density: share of neighboring pixels with different labels.
        pieces: number of connected pieces.
        present: number of labels.
    """

    compactness: Float[Array, ""]
    density: Float[Array, ""]
    pieces: Int[Array, ""]
    present: Int[Array, ""]


def table(
    labels: Int[Array, "y x"], objects: Int[Array, "y x"], shape: tuple[int, int]
) -> Int[Array, "n k"]:
    """Counts the pixels of every superpixel, 0 included, on every object."""
    return jnp.zeros(shape, jnp.int32).at[labels, objects].add(1, mode="promise_in_bounds")


def overlap(counts: Int[Array, "n k"], dtype) -> Overlap:
    """Undersegmentation of one view; pixels without a label leak, except in (5.3)."""
    inside = counts.astype(dtype)
    size = jnp.sum(inside, axis=1, keepdims=True)
    leak = jnp.minimum(inside, size - inside)
    total, objects = jnp.sum(inside), jnp.sum(inside, axis=0)
    there = objects > 0
    shares = jnp.where(there, jnp.sum(leak, axis=0) / jnp.where(there, objects, 1), 0)
    once = (size[:, 0] - jnp.max(inside, axis=1)).at[0].set(size[0, 0])
    return Overlap(
        jnp.sum(shares) / jnp.sum(there).astype(dtype),
        jnp.sum(leak.at[0].set(inside[0])) / total,
        jnp.sum(once) / total,
    )


def _differ(labels: Int[Array, "y x"]) -> tuple[Bool[Array, "y w"], Bool[Array, "h x"]]:
    """Whether neighbors in rows and in columns have different labels, both of them one."""
    right = (labels[:, 1:] != labels[:, :-1]) & (labels[:, 1:] > 0) & (labels[:, :-1] > 0)
    down = (labels[1:] != labels[:-1]) & (labels[1:] > 0) & (labels[:-1] > 0)
    return right, down


def _at_steps(labels: Int[Array, "y x"]) -> Bool[Array, "y x"]:
    """Pixels with a neighbor of another label."""
    right, down = _differ(labels)
    beside = jnp.pad(right, ((0, 0), (0, 1))) | jnp.pad(right, ((0, 0), (1, 0)))
    return beside | jnp.pad(down, ((0, 1), (0, 0))) | jnp.pad(down, ((1, 0), (0, 0)))


def recalled(
    labels: Int[Array, "y x"], objects: Int[Array, "y x"]
) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """How many pixels at outlines of objects have a boundary of superpixels near; how many are."""
    wanted = _at_steps(objects + 1)
    near = highest(_at_steps(labels).astype(jnp.float32), _REACH) > 0
    return jnp.sum(wanted & near, dtype=jnp.int32), jnp.sum(wanted, dtype=jnp.int32)


def shape_of(labels: Int[Array, "y x"], count: int, dtype) -> Shape:
    """Compactness, boundaries and pieces of one view; `count` labels, 0 included."""
    right, down = labels[:, 1:] != labels[:, :-1], labels[1:] != labels[:-1]
    sides = jnp.zeros(labels.shape, jnp.int32)
    for axis, differ in ((1, right), (0, down)):
        for before in (False, True):
            margin = [(0, 0), (0, 0)]
            margin[axis] = (1, 0) if before else (0, 1)
            # What lies beyond the frame is another region.
            sides = sides + jnp.pad(differ, margin, constant_values=True).astype(jnp.int32)

    def per_label(values: Array) -> Array:
        return jnp.zeros(count, values.dtype).at[labels].add(values, mode="promise_in_bounds")

    area = per_label(jnp.ones(labels.shape, dtype))
    length = per_label(sides.astype(dtype))
    there = area > 0
    terms = jnp.where(there, 4 * jnp.pi * area**2 / jnp.where(there, length, 1) ** 2, 0)
    root = components(jnp.pad(~right, ((0, 0), (0, 1))), jnp.pad(~down, ((0, 1), (0, 0)))).ravel()
    first = (root == jnp.arange(root.size, dtype=jnp.int32)) & (labels.ravel() > 0)
    pairs = right.size + down.size
    return Shape(
        jnp.sum(terms[1:]) / labels.size,
        (jnp.sum(right, dtype=jnp.int32) + jnp.sum(down, dtype=jnp.int32)).astype(dtype) / pairs,
        jnp.sum(first, dtype=jnp.int32),
        jnp.sum(there[1:], dtype=jnp.int32),
    )
