"""The photograph whose depth is estimated."""

import math
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from mvedge_jax.image import highest
from mvedge_jax.photometry.views import ViewSet

from ._photographs import Photographs, projections

# View steps to the farthest photograph, as in a light field of 9x9 views, so that parameters in px
# per view step mean the same.
STEPS = 4.0
# Radius of the pixels that mostly determine an interpolated color, px.
_INTERPOLATED = 2
# Least depth as a share of the distance to the farthest camera.
_LEAST = 1e-6
# Without points or a range, no surface is nearer than this many times the largest baseline.
_NEAREST = 8.0
# Margin of the points' range, as a share of the range of inverse depths.
_MARGIN = 0.15


class Reference(eqx.Module):
    """The photograph whose depth is estimated, and the unit of its disparities.

    Attributes:
        index: of the photograph.
        baseline: the disparity of a pixel is its focal length, px, times this over its depth; in
            the unit of the poses.
        disparity_range: lowest and highest disparity to search.
    """

    index: Int[Array, ""]
    baseline: Float[Array, ""]
    disparity_range: Float[Array, "2"]

    def scale(self, photographs: Photographs) -> Float[Array, ""]:
        """Disparity times depth.

        Args:
            photographs: photographs with the focal length of the reference.

        Returns:
            px times the unit of the poses. Differentiable.
        """
        matrix = photographs.intrinsics[self.index]
        return jnp.sqrt(matrix[0, 0] * matrix[1, 1]) * self.baseline.astype(matrix.dtype)

    def order(self, photographs: Photographs) -> Int[Array, " n"]:
        """Indices of the photographs, the reference first."""
        count = photographs.images.shape[0]
        return (jnp.arange(count, dtype=jnp.int32) + self.index) % count

    def views(self, photographs: Photographs) -> ViewSet:
        """The photographs in this order.

        Photographs from the reference's position have no information about depth and are not read.
        A pixel is `shown` if all pixels that its interpolated colors depend on are opaque.

        Args:
            photographs: two or more.

        Returns:
            The views. Differentiable.
        """
        order, scale = self.order(photographs), self.scale(photographs)
        parallax = projections(photographs.poses[order], photographs.intrinsics[order], 0, scale)
        apart, shown = lax.stop_gradient(parallax.apart), None
        available = (apart > 1e-3 * jnp.max(apart)) | (jnp.arange(order.size) == 0)
        planes = jnp.moveaxis(photographs.images[order], -1, 1)
        if photographs.mask is not None:
            clear = (~photographs.mask[order]).astype(planes.dtype)
            shown = 1 - jax.vmap(partial(highest, radius=_INTERPOLATED))(clear)
        return ViewSet(planes, parallax, available, shown)


def reference_of(
    photographs: Photographs,
    index: int | str,
    *,
    depth_range: tuple[float, float] | None = None,
) -> Reference:
    """Chooses the unit of a photograph's disparities, on the host.

    Args:
        photographs: two or more.
        index: of the photograph, or its name.
        depth_range: nearest and farthest depth to search, in the unit of the poses. The default is
            that of the sparse points with a margin or, without points, from eight times the
            largest baseline to infinity.

    Returns:
        A baseline of a fourth of the distance to the farthest camera, and the range.

    Raises:
        ValueError: the photograph does not exist, all cameras are in one place, the range is empty
            or not positive, or no point lies in the photograph's frame.

    Example:
        >>> poses = jnp.stack([jnp.eye(4), jnp.eye(4).at[0, 3].set(0.4)])
        >>> matrix = jnp.asarray([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]])
        >>> pair = Photographs(jnp.zeros((2, 12, 16, 3)), poses, matrix)
        >>> reference_of(pair, 0, depth_range=(1.0, 4.0)).disparity_range.round(3).tolist()
        [0.5, 2.0]
    """
    index = photographs.index(index) if isinstance(index, str) else index
    count = len(photographs.names)
    if not 0 <= index < count:
        raise ValueError(f"`index` must be between 0 and {count - 1}, got {index}.")
    centers = np.asarray(photographs.centers, np.float64)
    farthest = float(np.linalg.norm(centers - centers[index], axis=1).max())
    if not farthest > 1e-9 * max(1.0, float(np.abs(centers).max())):
        raise ValueError(
            "`photographs` have zero baseline: all cameras are in one place, expected at least two "
            "places to see depth from."
        )
    near, far = _inverse_range(photographs, index, depth_range, farthest)
    baseline = farthest / STEPS
    matrix = np.asarray(photographs.intrinsics[index], np.float64)
    scale = math.sqrt(matrix[0, 0] * matrix[1, 1]) * baseline
    dtype = photographs.images.dtype
    return Reference(
        jnp.asarray(index, jnp.int32),
        jnp.asarray(baseline, dtype),
        jnp.asarray([far * scale, near * scale], dtype),
    )


def _inverse_range(
    photographs: Photographs,
    index: int,
    depth_range: tuple[float, float] | None,
    farthest: float,
) -> tuple[float, float]:
    """Inverse depths of the nearest and the farthest surface."""
    if depth_range is not None:
        near, far = depth_range
        if not 0 < near < far:
            raise ValueError(f"`depth_range` must be 0 < near < far, got ({near:.4g}, {far:.4g}).")
        least = _LEAST * farthest
        if near < least:
            raise ValueError(
                f"`depth_range` must begin at {least:.3g} or more, a millionth of the distance "
                f"to the farthest camera, got {near:.4g}."
            )
        return 1 / near, 1 / far
    if photographs.points is None:
        return 1 / (_NEAREST * farthest), 0.0
    inverse = 1 / photographs.point_depths(index)
    if inverse.size < 2:
        raise ValueError(
            f"`photographs` have {inverse.size} points in the frame of {photographs.names[index]}, "
            "expected at least 2 to tell its range of depths; give a `depth_range`."
        )
    # A few points of every reconstruction are wrong.
    far, near = np.quantile(inverse, (0.01, 0.99))
    margin = _MARGIN * (near - far) + 0.02 * near
    return near + margin, max(far - margin, 0.2 * far)
