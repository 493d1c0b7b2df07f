"""The baseline of bidirectional diffusion: the side whose map reprojects better."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._crosshair import Arm
from mvedge_jax.interpolation import sample
from mvedge_jax.photometry.measuring import visible_view_range

from .._points import EdgePoints


def reprojection_score(
    points: EdgePoints,
    forward: Float[Array, "y x"],
    backward: Float[Array, "y x"],
    horizontal: Arm,
    vertical: Arm,
    *,
    radius: int,
) -> Float[Array, " n"]:
    """Reprojection error of the backward map minus that of the forward map at every point.

    All crosshair views are warped to the center by either map, occlusions left out; the error of a
    pixel is its mean absolute color difference over the views that show it.

    Args:
        points: positions to compare at.
        forward: map with the labels moved along the normals.
        backward: map with the labels moved against the normals.
        horizontal: the horizontal arm.
        vertical: the vertical arm, transposed.
        radius: largest distance of occluders, px.

    Source: Thesis 6.2.4, "Diffusion Gradients as Self-supervised Loss", Tab. 6.2.
    """

    def error(disparity: Array) -> Array:
        across, seen_across = _arm_error(horizontal, disparity, radius)
        down, seen_down = _arm_error(vertical, disparity.T, radius)
        return (across + down.T) / jnp.maximum(seen_across + seen_down.T, 1)

    score = sample(error(backward), points.xy) - sample(error(forward), points.xy)
    return jnp.where(points.valid, score, 0)


def _arm_error(arm: Arm, disparity: Array, radius: int) -> tuple[Array, Array]:
    negative, positive = visible_view_range(disparity, radius=radius)
    width, channels = disparity.shape[1], arm.planes.shape[1]
    columns = jnp.arange(width, dtype=disparity.dtype)[None, :]

    def add(
        total: tuple[Array, Array], view: tuple[Array, Array, Array]
    ) -> tuple[tuple[Array, Array], None]:
        planes, step, there = view
        position = columns + step * disparity
        whole = jnp.floor(position)
        part = position - whole
        left = jnp.clip(whole.astype(jnp.int32), 0, width - 1)
        right = jnp.clip(left + 1, 0, width - 1)
        reach = jnp.where(step < 0, negative, positive)
        inside = (position >= 0) & (position <= width - 1)
        seen = (step != 0) & there & inside & (jnp.abs(step) < reach - 0.5)
        difference = jnp.zeros_like(disparity)
        for c in range(channels):
            at_left, at_right = (
                jnp.take_along_axis(planes[c], place, axis=-1, mode="promise_in_bounds")
                for place in (left, right)
            )
            value = (1 - part) * at_left + part * at_right
            difference = difference + jnp.abs(value - arm.planes[arm.center, c])
        weight = seen.astype(disparity.dtype)
        return (total[0] + weight * difference / channels, total[1] + weight), None

    zero = jnp.zeros_like(disparity)
    return lax.scan(add, (zero, zero), (arm.planes, arm.steps, arm.available))[0]
