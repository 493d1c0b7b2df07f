"""Evidence for the side of an edge that shows the surface of the label."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax.image import nearest_pixels
from mvedge_jax.interpolation import exact_shift

from .._points import EdgePoints
from .._raster import Raster


def neighbor_evidence(
    points: EdgePoints,
    raster: Raster,
    *,
    radius: Float[Array, ""],
    cap: Float[Array, ""],
) -> Float[Array, " n"]:
    r"""How much better the labels on the `+normal` side agree with a point's own label, px.

    Means of $\min(|\Delta d|, c)$ over the labels on either side, weighted by a Gaussian of the
    distance: backward minus forward, 0 without neighbors on both sides. It chooses as well as two
    solves, and needs none. Differentiable at the rasterization chosen.

    Args:
        points: positions, disparities, normals.
        raster: the points on their own pixels.
        radius: standard deviation of the Gaussian, px.
        cap: where differences of disparity stop counting, px.
    """
    shape = (raster.hit.shape[0], raster.hit.shape[1])
    labels = raster.values(points.disparity).reshape(-1)
    there = raster.hit.reshape(-1)
    tangent = jnp.stack([-points.normal[:, 1], points.normal[:, 0]], -1)
    along, across = np.meshgrid([-4.0, 0.0, 4.0], np.arange(2.0, 10.0))
    dtype = points.disparity.dtype
    stencil = jnp.asarray(np.stack([across.ravel(), along.ravel()], -1), dtype)

    def side(sign: float) -> tuple[Array, Array]:
        @jax.checkpoint
        def add(total: tuple[Array, Array], place: Array) -> tuple[tuple[Array, Array], None]:
            shift = sign * place[0] * points.normal + place[1] * tangent
            at = nearest_pixels(points.xy + exact_shift(shift), shape)
            index = at.places(shape[1])
            near = jnp.exp(-0.5 * jnp.sum(place**2) / radius**2)
            weight = jnp.where(at.inside & there[index], near, 0)
            difference = jnp.minimum(jnp.abs(labels[index] - points.disparity), cap)
            return (total[0] + weight * difference, total[1] + weight), None

        zero = jnp.zeros_like(points.disparity)
        return lax.scan(add, (zero, zero), stencil)[0]

    ahead, seen_ahead = side(1.0)
    behind, seen_behind = side(-1.0)
    both = points.valid & (seen_ahead > 0) & (seen_behind > 0)
    return jnp.where(
        both,
        behind / jnp.where(both, seen_behind, 1) - ahead / jnp.where(both, seen_ahead, 1),
        0,
    )


def map_evidence(
    points: EdgePoints, disparity: Float[Array, "y x"], *, cap: Float[Array, ""]
) -> Float[Array, " n"]:
    """How much better a dense map on the `+normal` side agrees with a point's own label, px.

    Differences of disparity, capped at `cap` px, 1 and 2 px away: backward mean minus forward mean.
    Differentiable at the pixels chosen.
    """
    shape = (disparity.shape[0], disparity.shape[1])

    def away(distance: float) -> Array:
        at = nearest_pixels(points.xy + exact_shift(distance * points.normal), shape)
        return jnp.minimum(jnp.abs(disparity[at.row, at.column] - points.disparity), cap)

    evidence = 0.5 * (away(-1.0) + away(-2.0) - away(1.0) - away(2.0))
    return jnp.where(points.valid, evidence, 0)
