"""The set of surface samples from which all views are drawn."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

# Source of a pixel.
SEEN, UNCOVERED, FILLED = 0, 1, 2


class Samples(NamedTuple):
    """Surface samples, measured in any view.

    Attributes:
        xy: position in the center view, px, where a nearer surface may hide it or beyond its frame.
        disparity: px per view step.
        error: standard error of the disparity, px.
        uncovered: whether the sample was measured in another view than the center view.
        valid: slots in use.
    """

    xy: Float[Array, "n 2"]
    disparity: Float[Array, " n"]
    error: Float[Array, " n"]
    uncovered: Bool[Array, " n"]
    valid: Bool[Array, " n"]


def samples_of(
    disparity: Float[Array, "y x"], error: Float[Array, "y x"], *, capacity: int
) -> Samples:
    """The pixels of the center view as samples, row by row, with room for more."""
    size, dtype = disparity.size, disparity.dtype
    rows, columns = jnp.indices(disparity.shape)
    xy = jnp.stack([columns, rows], axis=-1).reshape(-1, 2).astype(dtype)
    room = ((0, capacity),)
    used = jnp.arange(size + capacity) < size
    return Samples(
        jnp.pad(xy, (*room, (0, 0))),
        jnp.pad(disparity.ravel(), room),
        jnp.pad(error.ravel(), room),
        ~used,
        used,
    )


def added(
    samples: Samples,
    disparity: Float[Array, "y x"],
    error: Float[Array, "y x"],
    wanted: Bool[Array, "y x"],
    step: Float[Array, "2"],
    *,
    count: Int[Array, ""],
) -> tuple[Samples, Int[Array, ""]]:
    """Adds wanted pixels of a view to the samples, in the free slots.

    Returns the samples and the new count of added ones, which may exceed the capacity.
    """
    shape, slots = disparity.shape, samples.valid.shape[0]
    place = count + jnp.cumsum(wanted.ravel(), dtype=count.dtype) - 1
    # Samples without a slot get an index beyond the last one and are dropped.
    place = jnp.where(wanted.ravel(), shape[0] * shape[1] + place, slots)
    rows, columns = jnp.indices(shape)
    pixels = jnp.stack([columns, rows], axis=-1).astype(disparity.dtype)
    xy = (pixels - step[None, None] * disparity[..., None]).reshape(-1, 2)

    def put(old: Array, new: Array) -> Array:
        return old.at[place].set(new, mode="drop", unique_indices=False)

    new = Samples(
        put(samples.xy, xy),
        put(samples.disparity, disparity.ravel()),
        put(samples.error, error.ravel()),
        samples.uncovered,
        put(samples.valid, jnp.ones(place.shape, bool)),
    )
    return new, count + jnp.sum(wanted, dtype=count.dtype)


def landed(samples: Samples, step: Float[Array, "2"], shape: tuple[int, int]) -> Int[Array, " n"]:
    """Flat index of the pixel of a view that each sample lands on; past the last one if outside.

    Halves are rounded upwards; otherwise a plane at half a pixel would become a comb.
    """
    xy, disparity = lax.stop_gradient((samples.xy, samples.disparity))
    height, width = shape
    x = jnp.floor(xy[:, 0] + step[0] * disparity + 0.5)
    y = jnp.floor(xy[:, 1] + step[1] * disparity + 0.5)
    inside = samples.valid & (x >= 0) & (x < width) & (y >= 0) & (y < height)
    index = y.astype(jnp.int32) * width + x.astype(jnp.int32)
    return jnp.where(inside, index, height * width)
