"""Between light fields, photographs and points in space."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import accepts_numpy
from mvedge_jax._product import product
from mvedge_jax.lightfield import Camera, LightField

from ._photographs import Photographs


class Surface(NamedTuple):
    """The surface of a depth map, in space.

    Attributes:
        points: in the world, `[y, x, 3]`.
        normals: unit vectors towards the camera, `[y, x, 3]`.
        whole: pixels whose neighbors are on the same surface, so that they have a normal.
    """

    points: Float[Array, "y x 3"]
    normals: Float[Array, "y x 3"]
    whole: Bool[Array, "y x"]


@accepts_numpy
def surface_of(
    depth: Float[Array, "y x"], pose: Float[Array, "4 4"], intrinsics: Float[Array, "3 3"]
) -> Surface:
    """The points of a depth map.

    Args:
        depth: along the optical axis, in the unit of the pose.
        pose: camera to world.
        intrinsics: px.

    Returns:
        Points and normals. Differentiable in all arguments.

    Example:
        >>> import jax.numpy as jnp
        >>> matrix = jnp.asarray([[10.0, 0, 2], [0, 10.0, 2], [0, 0, 1]])
        >>> wall = surface_of(jnp.full((5, 5), 3.0), jnp.eye(4), matrix)
        >>> wall.points[2, 4].round(3).tolist(), wall.normals[2, 2].tolist()
        ([0.6..., 0.0, 3.0], [0.0, 0.0, -1.0])
    """
    height, width = depth.shape
    x = (jnp.arange(width, dtype=depth.dtype) - intrinsics[0, 2]) / intrinsics[0, 0]
    y = (jnp.arange(height, dtype=depth.dtype) - intrinsics[1, 2]) / intrinsics[1, 1]
    ray = jnp.stack(jnp.broadcast_arrays(x[None], y[:, None], jnp.ones_like(depth)), axis=-1)
    local = ray * depth[..., None]
    across, down = (_middle(local, axis) for axis in (1, 0))
    normal = -jnp.cross(across, down)
    square = jnp.sum(normal**2, axis=-1, keepdims=True)
    known = square > 0
    normal = jnp.where(known, normal / jnp.sqrt(jnp.where(known, square, 1)), -ray)
    # Depths of one surface are those of a plane through it, to a part of its slope.
    bend = sum(jnp.abs(_bend(1 / depth, axis)) for axis in (0, 1)) * depth
    slope = sum(jnp.abs(_middle(1 / depth, axis)) for axis in (0, 1)) * depth
    whole = known[..., 0] & (bend < 0.01 + 0.5 * slope) & (slope < 0.2)
    turn = pose[:3, :3].T
    points = product(local, turn) + pose[:3, 3][None, None]
    return Surface(points, product(normal, turn), whole)


def _middle(values: Array, axis: int) -> Array:
    """Central differences, one-sided at the border."""
    ahead, behind = _neighbors(values, axis)
    return 0.5 * (ahead - behind)


def _bend(values: Array, axis: int) -> Array:
    ahead, behind = _neighbors(values, axis)
    return ahead + behind - 2 * values


def _neighbors(values: Array, axis: int) -> tuple[Array, Array]:
    margin = [(0, 0)] * values.ndim
    margin[axis] = (1, 1)
    # The border goes on as it ends.
    padded = jnp.pad(values, margin, mode="reflect", reflect_type="odd")
    size = values.shape[axis]
    return (
        jax.lax.slice_in_dim(padded, 2, size + 2, axis=axis),
        jax.lax.slice_in_dim(padded, 0, size, axis=axis),
    )


@accepts_numpy
def camera_of_view(
    camera: Camera, away: Float[Array, "2"], shape: tuple[int, int]
) -> tuple[Float[Array, "4 4"], Float[Array, "3 3"]]:
    """Pose and intrinsics of a view of a light field; the center view's camera is the world.

    Args:
        camera: of the light field.
        away: columns and rows of views from the center to the view: the opposite of
            `LightField.steps`.
        shape: height and width of the views, px.

    Returns:
        Camera to world, meters, and intrinsics, px. The sensor's shift, which gives one distance
        the disparity 0, moves the principal point.
    """
    dtype = away.dtype
    height, width = shape
    focal, baseline = camera.focal_px.astype(dtype), camera.baseline.astype(dtype)
    shift = focal * baseline / camera.focus_distance.astype(dtype)
    pose = jnp.eye(4, dtype=dtype).at[:2, 3].set(away * baseline)
    matrix = jnp.eye(3, dtype=dtype).at[0, 0].set(focal).at[1, 1].set(focal)
    middle = jnp.asarray([(width - 1) / 2, (height - 1) / 2], dtype)
    return pose, matrix.at[:2, 2].set(middle + away * shift)


def photographs_of(light_field: LightField) -> Photographs:
    """A light field as posed photographs, on the host: every view with its camera.

    Args:
        light_field: with a known camera.

    Returns:
        The views that are there, row by row, named as in the HCI benchmark; the world is the center
        view's camera, meters. True depth comes along where it is known of all views.

    Raises:
        ValueError: the light field does not know its camera.

    Example:
        >>> import jax.numpy as jnp
        >>> field = LightField(jnp.zeros((3, 3, 8, 8, 3)), camera=Camera(20.0, 0.1, 2.0))
        >>> views = photographs_of(field)
        >>> views.names[5], views.poses[5, 0, 3].round(3).item(), views.intrinsics[5, 0, 2].item()
        ('input_Cam005.png', 0.1, 4.5)
    """
    camera = light_field.camera
    if camera is None:
        raise ValueError(
            f"`light_field`, {light_field.name}, does not know its camera; expected focal length, "
            "baseline and focus distance."
        )
    rows, columns, height, width = light_field.views.shape[:4]
    there = np.argwhere(np.asarray(light_field.available))
    away = -np.asarray(light_field.steps)
    cameras = [camera_of_view(camera, jnp.asarray(away[v, u]), (height, width)) for v, u in there]
    rows_of, columns_of = there.T
    truth, depth = light_field.truth, None
    if truth is not None and truth.view_disparity is not None:
        depth = camera.depth(truth.view_disparity[rows_of, columns_of])
        depth = jnp.where(jnp.isfinite(depth), depth, 0)
    return Photographs(
        light_field.views[rows_of, columns_of],
        jnp.stack([pose for pose, _ in cameras]),
        jnp.stack([matrix for _, matrix in cameras]),
        depth=depth,
        names=tuple(f"input_Cam{columns * v + u:03d}.png" for v, u in there),
        name=light_field.name,
    )
