"""The vignette mask: black corners of a plenoptic camera's views."""

import functools

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._crosshair import Crosshair
from mvedge_jax._params import cast

from ._brightness import Brightness


def lit(arms: Crosshair, params: Brightness) -> Float[Array, "y x"]:
    """0 in the vignette mask and around it, 1 elsewhere; a constant for derivatives.

    The mask of the lens has the same position in every view. So a pixel is in the mask if it is
    black in the center view, dark at the same position in half of the others, and so are all pixels
    between it and one side of the frame. The outline of the mask is no edge of the scene.
    """
    params = cast(params, arms.center.dtype)
    center = jnp.max(arms.center, axis=0)
    dark = [
        jnp.sum(jnp.max(arm.planes, axis=1) < params.dark, axis=0, dtype=jnp.int32) for arm in arms
    ]
    views = sum(arm.planes.shape[0] for arm in arms)
    black = (center < params.black) & (2 * (dark[0] + dark[1].T) >= views)
    dark_from_side = [
        _before_light(black, axis, reverse) for axis in (0, 1) for reverse in (False, True)
    ]
    unlit = functools.reduce(jnp.logical_or, dark_from_side).astype(center.dtype)
    window = (2 * params.dark_reach + 1,) * 2
    around = lax.reduce_window(unlit, -jnp.inf, lax.max, window, (1, 1), "SAME")
    return lax.stop_gradient(1 - around)


def _before_light(black: Bool[Array, "y x"], axis: int, reverse: bool) -> Bool[Array, "y x"]:
    """Pixels between a side of the image and the first pixel that is not black."""
    size = black.shape[axis]
    index = lax.broadcasted_iota(jnp.int32, black.shape, axis)
    index = size - 1 - index if reverse else index
    return index < jnp.min(jnp.where(black, size, index), axis=axis, keepdims=True)
