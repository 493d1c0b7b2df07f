"""What the lens leaves dark: the corners of a plenoptic camera's views."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._crosshair import Arm

# Brightness below which a pixel of the centre view is black, and one of the other views dark.
_BLACK, _DARK = 0.5 / 255, 0.02
# Pixels around what is unlit whose windows reach into it.
_REACH = 3


def lit(arms: tuple[Arm, Arm]) -> Float[Array, "y x"]:
    """Where light of the scene arrived: 0 in what is dark from the frame inwards, and around it.

    A mask of the lens stays where it is from view to view. So a pixel is unlit if it is black in
    the centre view, dark at the same place in half of the others, and so is everything between it
    and one side of the frame. Its outline is none of the scene, and what is behind it unknown.

    Args:
        arms: of the crosshair, as they were taken.

    Returns:
        0 or 1, a constant for derivatives.
    """
    horizontal, _ = arms
    centre = jnp.max(horizontal.planes[horizontal.centre], axis=0)
    dark = [jnp.sum(jnp.max(arm.planes, axis=1) < _DARK, axis=0, dtype=jnp.int32) for arm in arms]
    views = sum(arm.planes.shape[0] for arm in arms)
    black = (centre < _BLACK) & (2 * (dark[0] + dark[1].T) >= views)
    sides = [
        lax.associative_scan(jnp.logical_and, black, axis=axis, reverse=reverse)
        for axis in (0, 1)
        for reverse in (False, True)
    ]
    unlit = (sides[0] | sides[1] | sides[2] | sides[3]).astype(centre.dtype)
    window = (2 * _REACH + 1,) * 2
    around = lax.reduce_window(unlit, -jnp.inf, lax.max, window, (1, 1), "SAME")
    return lax.stop_gradient(1 - around)
