"""Which pixels of a map are scored: ground truth, masks, crops and bands around depth edges."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import accepts_numpy


def check_maps(disparity: Any, truth: Any, mask: Any, crop: int) -> None:
    """Raises an error that names the argument if the maps do not fit together, or are none."""
    for name, given in (("disparity", disparity), ("truth", truth), ("mask", mask)):
        check_map(name, given)
    if disparity.ndim != 2:
        raise ValueError(f"`disparity` must have the axes [y, x], got shape {disparity.shape}.")
    for name, other in (("truth", truth), ("mask", mask)):
        if other is not None and other.shape != disparity.shape:
            raise ValueError(
                f"`{name}` must have the shape of `disparity`, {disparity.shape}, got "
                f"{other.shape}; crop the larger one to its center first."
            )
    check_crop(disparity.shape, crop)


def check_map(name: str, given: Any) -> None:
    """Raises a TypeError if an argument is not an array, such as a result or a light field."""
    if given is None or hasattr(given, "shape"):
        return
    wish = {"disparity": "`result.disparity`", "truth": "`light_field.truth.disparity`"}
    hint = f", such as {wish[name]}" if name in wish else ""
    raise TypeError(f"`{name}` must be a map [y, x]{hint}, got {type(given).__name__}.")


def check_crop(shape: tuple[int, ...], crop: int) -> None:
    """Raises a ValueError if a crop leaves nothing of a map of height and width."""
    if not 0 <= 2 * crop < min(shape):
        raise ValueError(
            f"`crop` must be at least 0 and leave pixels of {shape[0]}x{shape[1]}, got {crop}."
        )


def cropped(values: Array, crop: int) -> Array:
    """`values` without `crop` pixels on each side of its first two axes."""
    height, width = values.shape[:2]
    return values[crop : height - crop, crop : width - crop]


def counted_pixels(
    truth: Float[Array, "y x"], mask: Bool[Array, "y x"] | None
) -> Bool[Array, "y x"]:
    """Where the truth is known and the mask, if any, is set."""
    known = jnp.isfinite(truth)
    return known if mask is None else known & mask


def depth_steps(disparity: Float[Array, "y x"], counted: Bool[Array, "y x"]) -> Float[Array, "y x"]:
    """Largest jump of disparity from a pixel to its right and lower neighbor, px per view step.

    Infinite where a value on either side is not finite, 0 to pixels that are not counted.
    """

    def jump(here: Array, there: Array, both: Array) -> Array:
        finite = jnp.isfinite(here) & jnp.isfinite(there)
        size = jnp.abs(jnp.where(finite, there, 0) - jnp.where(finite, here, 0))
        return jnp.where(both, jnp.where(finite, size, jnp.inf), 0)

    right = jump(disparity[:, :-1], disparity[:, 1:], counted[:, :-1] & counted[:, 1:])
    down = jump(disparity[:-1], disparity[1:], counted[:-1] & counted[1:])
    return jnp.maximum(jnp.pad(right, ((0, 0), (0, 1))), jnp.pad(down, ((0, 1), (0, 0))))


def disc_maximum(values: Float[Array, "y x"], radius: float) -> Float[Array, "y x"]:
    """Largest value within `radius` px (Euclidean, static) of each pixel; values are at least 0."""
    reach = math.floor(radius)
    offsets = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1).T
    offsets = offsets[(offsets**2).sum(1) <= radius**2] + reach
    padded = jnp.pad(values, reach)

    def widen(largest: Array, offset: Array) -> tuple[Array, None]:
        shifted = jax.lax.dynamic_slice(padded, (offset[0], offset[1]), values.shape)
        return jnp.maximum(largest, shifted), None

    return jax.lax.scan(widen, values, jnp.asarray(offsets, jnp.int32))[0]


@accepts_numpy
def edge_band(
    truth: Float[Array, "y x"],
    *,
    mask: Bool[Array, "y x"] | None = None,
    threshold: float | Float[Array, ""] = 0.1,
    radius: float = 5.0,
) -> Bool[Array, "y x"]:
    """Pixels close to a depth edge of the ground truth: a mask for every depth metric.

    A pixel is on a depth edge if the disparity jumps by more than `threshold` to its right or lower
    neighbor. Jumps to or from pixels that are not counted are ignored.

    Args:
        truth: Ground-truth disparity, `[y, x]`, px per view step; NaN where unknown.
        mask: Pixels that take part, `[y, x]`; all by default.
        threshold: Smallest jump of an edge, px per view step, traced.
        radius: Half width of the band, px (Euclidean), static.

    Returns:
        `[y, x]`, True on counted pixels within `radius` of an edge. Not differentiable.

    Example:
        >>> import jax.numpy as jnp
        >>> truth = jnp.where(jnp.arange(9) < 4, 1.0, 0.0)[None, :]
        >>> edge_band(truth, radius=1.0).astype(int).tolist()
        [[0, 0, 1, 1, 1, 0, 0, 0, 0]]
    """
    check_maps(truth, truth, mask, 0)
    counted = counted_pixels(truth, mask)
    edges = depth_steps(truth, counted) > threshold
    return counted & (disc_maximum(edges.astype(truth.dtype), radius) > 0)
