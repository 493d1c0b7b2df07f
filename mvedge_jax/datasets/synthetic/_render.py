"""Rendering: a grid of views, or posed photographs, with exact disparity, depth and ids."""

import concurrent.futures
import math
import os
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from ...lightfield import GroundTruth, LightField
from ._intersect import Vector, along, intersect, intersect_and_shadow, rotate
from ._shade import lamp_directions, shade
from ._world import Scene, Sensor, World

_RAYS = 16384  # traced at once: their intermediate arrays stay in the cache
_BLUR_REACH = 9  # px, three standard deviations of the widest blur


class Pinhole(eqx.Module):
    """A camera without distortion."""

    origin: Float[Array | np.ndarray, "3"]
    rotation: Float[Array | np.ndarray, "3 3"]  # camera to world; x right, y down, z forward
    focal: Float[Array | np.ndarray, "2"]
    principal: Float[Array | np.ndarray, "2"]


class PosedViews(NamedTuple):
    """Photographs with known poses: what multi-view stereo starts from.

    Attributes:
        images: sRGB in [0, 1].
        depth: distance along the optical axis of the pixel centres, metres; infinite for the sky.
        object_ids: what the pixel centres see; 0 for the sky.
        poses: camera to world; x right, y down, z forward.
        intrinsics: `[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]`, px.
    """

    images: Float[Array, "n y x 3"]
    depth: Float[Array, "n y x"]
    object_ids: Int[Array, "n y x"]
    poses: Float[Array, "n 4 4"]
    intrinsics: Float[Array, "n 3 3"]


def _tent(samples: int) -> np.ndarray:
    """Offsets, px, at equal quantiles of a tent of half width 1: samples of equal weight."""
    quantile = (np.arange(samples) + 0.5) / samples
    left = np.sqrt(2 * np.minimum(quantile, 1 - quantile)) - 1
    return np.where(quantile < 0.5, left, -left)


def _rays(pinhole: Pinhole, x: Array, y: Array) -> tuple[Vector, Vector]:
    """Rays through pixels of one camera, scaled so that the distance is the depth."""
    across = (
        (x - pinhole.principal[0]) / pinhole.focal[0],
        (y - pinhole.principal[1]) / pinhole.focal[1],
        jnp.ones_like(x),
    )
    origin = (pinhole.origin[0], pinhole.origin[1], pinhole.origin[2])
    return origin, rotate(pinhole.rotation, across)


def _encode(linear: Array) -> Array:
    """Linear light to sRGB, clipped to what a sensor holds."""
    linear = jnp.clip(linear, 0.0, 1.0)
    curve = 1.055 * jnp.maximum(linear, 1e-4) ** (1 / 2.4) - 0.055
    return jnp.where(linear <= 0.0031308, 12.92 * linear, curve)


def _blur(image: Float[Array, "y x 3"], sigma: Array) -> Array:
    """Gaussian blur; the identity for a width of 0."""
    reach = _BLUR_REACH
    offsets = jnp.arange(-reach, reach + 1, dtype=image.dtype)
    taps = jnp.exp(-0.5 * (offsets / jnp.maximum(sigma, 1e-2)) ** 2)
    taps = taps / taps.sum()
    padded = jnp.pad(image, ((reach, reach), (reach, reach), (0, 0)), mode="edge")
    planes = jnp.moveaxis(padded, -1, 0)[:, None]
    for kernel in (taps[None, None, :, None], taps[None, None, None, :]):
        planes = lax.conv_general_dilated(planes, kernel, (1, 1), "VALID")
    return jnp.moveaxis(planes[:, 0], 0, -1)


def _add_noise(image: Float[Array, "y x 3"], sensor: Sensor, key: PRNGKeyArray) -> Array:
    deviation = jnp.sqrt(sensor.read_noise**2 + sensor.shot_noise * image)
    return image + deviation * jax.random.normal(key, image.shape, image.dtype)


class _Mode(NamedTuple):
    """What is compiled in; the rest of a scene is data."""

    size: tuple[int, int]
    samples: int
    exposed: bool  # blur or noise


def _mode(scene: Scene, size: tuple[int, int], samples: int) -> _Mode:
    sensor = scene.sensor
    return _Mode(
        size,
        samples,
        exposed=any(float(x) > 0 for x in (sensor.blur, sensor.read_noise, sensor.shot_noise)),
    )


@partial(jax.jit, static_argnames=("mode",))
def _trace_view(
    world: World,
    sensor: Sensor,
    pinhole: Pinhole,
    key: PRNGKeyArray,
    view: Int[Array, ""],
    *,
    mode: _Mode,
) -> tuple[Array, Array, Array]:
    """Image, depth and ids of one view."""
    height, width = mode.size
    samples = mode.samples
    dtype = world.solids.centre.dtype
    per_pixel = samples * samples
    # Tiles, nearly square and nearly equal: their rays pass by most solids.
    side = max(1, math.isqrt(_RAYS // per_pixel))
    down, across = -(-height // side), -(-width // side)
    tall, wide = -(-height // down), -(-width // across)
    offsets = jnp.asarray(_tent(samples), dtype)
    dy, dx = (o.reshape(-1) for o in jnp.meshgrid(offsets, offsets, indexing="ij"))
    # The truth is that of the pixel's centre: the middle sample, or one more if there is no middle.
    if samples % 2 == 0:
        dy, dx = jnp.pad(dy, (0, 1)), jnp.pad(dx, (0, 1))
    middle = per_pixel // 2 if samples % 2 else per_pixel
    axis = (pinhole.rotation[0, 2], pinhole.rotation[1, 2], pinhole.rotation[2, 2])
    light = world.light
    # The extra sample of the truth looks at any point of the lamp.
    towards = lamp_directions(light, len(dx))
    lamp_x, lamp_y, lamp_z = (jnp.repeat(t, tall * wide) for t in towards)
    shaded = per_pixel * tall * wide

    def tile(number: Array) -> tuple[Array, Array, Array]:
        first_row, first_column = number // across * tall, number % across * wide
        lines = (first_row + jnp.arange(tall, dtype=jnp.int32)).astype(dtype)
        columns = (first_column + jnp.arange(wide, dtype=jnp.int32)).astype(dtype)
        # Supersamples outermost: [sample, row, column].
        x = jnp.broadcast_to(dx[:, None, None] + columns[None, None, :], (len(dx), tall, wide))
        y = jnp.broadcast_to(dy[:, None, None] + lines[None, :, None], (len(dy), tall, wide))
        origin, direction = _rays(pinhole, x.reshape(-1), y.reshape(-1))
        distance, hit, hidden = intersect_and_shadow(
            world.solids, origin, direction, (lamp_x, lamp_y, lamp_z), light.shadow > 0
        )
        depth = distance.reshape(-1, tall, wide)[middle]
        index = hit.reshape(-1, tall, wide)[middle]
        distance, hit, hidden = distance[:shaded], hit[:shaded], hidden[:shaded]
        visible = jnp.where(hidden, 1.0 - light.shadow, 1.0)
        direction = (direction[0][:shaded], direction[1][:shaded], direction[2][:shaded])
        footprint = jnp.where(hit < 0, 1.0, distance) / pinhole.focal.min()
        colour = shade(
            world,
            origin,
            direction,
            distance,
            hit,
            footprint,
            axis,
            visible,
        )
        return colour.reshape(3, per_pixel, tall, wide).mean(1), depth, index

    def picture(tiles: Array) -> Array:
        whole = tiles.reshape(down, across, tall, wide).swapaxes(1, 2)
        return whole.reshape(down * tall, across * wide)[:height, :width]

    colour, depth, index = lax.map(tile, jnp.arange(down * across, dtype=jnp.int32))
    depth, index = picture(depth), picture(index)
    image = jnp.stack([picture(colour[:, c]) for c in range(3)], axis=-1)
    ids = jnp.where(index < 0, 0, world.solids.object_id[jnp.maximum(index, 0)])
    if mode.exposed:
        image = _encode(_blur(image, sensor.blur))
        image = jnp.clip(_add_noise(image, sensor, jax.random.fold_in(key, view)), 0.0, 1.0)
    else:
        image = _encode(image)
    return image, depth, ids


def _trace_views(
    scene: Scene,
    pinholes: list[Pinhole],
    mode: _Mode,
    progress: Callable[[int, int], None] | None,
    key: PRNGKeyArray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Traces views on all cores, straight into arrays: one view per core is in flight."""
    dtype = np.dtype(scene.world.solids.centre.dtype)
    count = len(pinholes)
    images = np.empty((count, *mode.size, 3), dtype)
    depth = np.empty((count, *mode.size), dtype)
    ids = np.empty((count, *mode.size), np.int32)

    def trace(k: int) -> None:
        view = np.asarray(k, np.int32)
        result = _trace_view(scene.world, scene.sensor, pinholes[k], key, view, mode=mode)
        images[k], depth[k], ids[k] = (np.asarray(part) for part in result)

    trace(0)  # compiles
    if progress is not None:
        progress(1, count)
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        try:
            tasks = pool.map(trace, range(1, count))
            for done, _ in enumerate(tasks, start=2):
                if progress is not None:
                    progress(done, count)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return images, depth, ids


def _check_shape(shape: tuple[int, ...], names: str) -> None:
    if len(shape) != len(names.split(", ")) or not all(
        isinstance(n, int | np.integer) and n > 0 for n in shape
    ):
        raise ValueError(f"`shape` must be positive integers ({names}), got {shape}.")


def _check_samples(samples: int) -> None:
    if not 1 <= samples <= 16:
        raise ValueError(f"`samples` must be between 1 and 16 per side of a pixel, got {samples}.")


def _grid_pinhole(scene: Scene, shape: tuple[int, int, int, int], v: int, u: int) -> Pinhole:
    """The camera of one view: parallel to the centre's, its sensor shifted."""
    rows, columns, height, width = shape
    dtype = np.dtype(scene.world.solids.centre.dtype)
    focal, gain, focus = (float(x) for x in (scene.rig.focal, scene.rig.gain, scene.rig.focus))
    focal_px = focal * max(height, width)
    du, dv = u - columns // 2, v - rows // 2
    baseline = gain / focal_px
    return Pinhole(
        origin=np.asarray([du * baseline, dv * baseline, 0.0], dtype),
        rotation=np.eye(3, dtype=dtype),
        focal=np.asarray([focal_px, focal_px], dtype),
        principal=np.asarray(
            [(width - 1) / 2 + du * gain / focus, (height - 1) / 2 + dv * gain / focus], dtype
        ),
    )


def render(
    scene: Scene,
    *,
    shape: tuple[int, int, int, int],
    samples: int = 3,
    progress: Callable[[int, int], None] | None = None,
    key: PRNGKeyArray,
) -> LightField:
    """Renders a light field with exact disparity and object ids for every view.

    The scene's disparities are in px per view step whatever the size: a smaller picture shows the
    same scene with a wider grid of cameras relative to it.

    Args:
        scene: see `scene` for those with a name and `make_world` for your own.
        shape: view rows, view columns (both odd), height and width in px.
        samples: the image averages `samples**2` rays per pixel, spread like a tent of half width
            1 px; the ground truth is that of the pixel's centre.
        progress: called with the number of views that are done and that there are.
        key: draws the sensor's noise; the same key gives the same pictures.

    Returns:
        A light field in the dtype of the scene, with the full `truth`, the exact `camera`
        and the disparity range. Object id 0 is the sky, whose disparity is that of infinity.
        Not differentiable: tracing the solids is a loop of data-dependent length.

    Raises:
        ValueError: if a size is not a positive integer, the number of view rows or columns is
            even, or `samples` is not in 1..16.

    Example:
        >>> import jax
        >>> from mvedge_jax.datasets import synthetic
        >>> light_field = synthetic.render(
        ...     synthetic.scene("crossing"), shape=(3, 3, 16, 16), samples=1, key=jax.random.key(0)
        ... )
        >>> light_field.views.shape, light_field.truth.view_disparity.shape
        ((3, 3, 16, 16, 3), (3, 3, 16, 16))
    """
    _check_shape(shape, "view rows, view columns, height, width")
    _check_samples(samples)
    rows, columns, height, width = (int(n) for n in shape)
    if rows % 2 == 0 or columns % 2 == 0:
        raise ValueError(
            f"`shape` must have odd numbers of view rows and columns, got {rows}x{columns}."
        )
    shape = (rows, columns, height, width)
    pinholes = [_grid_pinhole(scene, shape, v, u) for v in range(rows) for u in range(columns)]
    mode = _mode(scene, (height, width), samples)
    images, depth, ids = _trace_views(scene, pinholes, mode, progress, key)
    # Moved into JAX one by one: what is held twice is one array at a time.
    views = jnp.asarray(images.reshape(*shape, 3))
    del images
    gain, focus = float(scene.rig.gain), float(scene.rig.focus)
    np.divide(gain, depth, out=depth)
    np.subtract(depth, gain / focus, out=depth)
    disparity = jnp.asarray(depth.reshape(shape))
    del depth
    ids = jnp.asarray(ids.reshape(shape))
    vc, uc = rows // 2, columns // 2
    return LightField(
        views,
        disparity_range=scene.disparity_range,
        truth=GroundTruth(
            disparity=disparity[vc, uc],
            valid=jnp.ones((height, width), bool),
            object_ids=ids[vc, uc],
            view_disparity=disparity,
            view_ids=ids,
        ),
        camera=scene.rig.camera(height, width),
        name=scene.name,
    )


def render_posed(
    scene: Scene,
    poses: Float[Array, "n 4 4"] | np.ndarray,
    intrinsics: Float[Array, "n 3 3"] | Float[Array, "3 3"] | np.ndarray,
    *,
    size: tuple[int, int],
    samples: int = 3,
    progress: Callable[[int, int], None] | None = None,
    key: PRNGKeyArray,
) -> PosedViews:
    """Renders photographs from anywhere, for multi-view stereo.

    Args:
        scene: what to photograph; metres, in the frame of the light field's centre camera.
        poses: camera to world, rigid; x right, y down, z forward.
        intrinsics: `[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]` in px, for each view or for all.
        size: height and width, px.
        samples: as for `render`.
        progress: as for `render`.
        key: draws the sensor's noise.

    Returns:
        Images, depth and object ids of the pixel centres, poses and intrinsics (one per view).

    Raises:
        ValueError: if a shape, a rotation or a size is wrong.
    """
    dtype = np.dtype(scene.world.solids.centre.dtype)
    pose = np.asarray(poses, np.float64)
    if pose.ndim != 3 or pose.shape[1:] != (4, 4):
        raise ValueError(f"`poses` must have the shape [n, 4, 4], got {pose.shape}.")
    turn = pose[:, :3, :3]
    if not np.allclose(turn @ turn.transpose(0, 2, 1), np.eye(3), atol=1e-4):
        raise ValueError("`poses` must be rigid (orthonormal rotations), got something else.")
    matrix = np.asarray(intrinsics, np.float64)
    if matrix.shape not in ((3, 3), (len(pose), 3, 3)):
        raise ValueError(
            f"`intrinsics` must have the shape [3, 3] or [{len(pose)}, 3, 3], got {matrix.shape}."
        )
    matrix = np.broadcast_to(matrix, (len(pose), 3, 3))
    _check_shape(size, "height, width")
    _check_samples(samples)
    pinholes = [
        Pinhole(
            p[:3, 3].astype(dtype),
            p[:3, :3].astype(dtype),
            np.asarray([k[0, 0], k[1, 1]], dtype),
            np.asarray([k[0, 2], k[1, 2]], dtype),
        )
        for p, k in zip(pose, matrix, strict=True)
    ]
    mode = _mode(scene, (int(size[0]), int(size[1])), samples)
    images, depth, ids = _trace_views(scene, pinholes, mode, progress, key)
    return PosedViews(
        jnp.asarray(images),
        jnp.asarray(depth),
        jnp.asarray(ids),
        jnp.asarray(pose.astype(dtype)),
        jnp.asarray(matrix.astype(dtype)),
    )


@partial(jax.jit, static_argnames=("size",))
def _sees(world: World, source: Pinhole, target: Pinhole, *, size: tuple[int, int]) -> Array:
    height, width = size
    dtype = world.solids.centre.dtype
    y, x = jnp.meshgrid(
        jnp.arange(height, dtype=dtype), jnp.arange(width, dtype=dtype), indexing="ij"
    )
    origin, direction = _rays(source, x.reshape(-1), y.reshape(-1))
    depth, index = intersect(world.solids, origin, direction)
    point = along(origin, direction, jnp.where(index < 0, 1e4, depth))
    eye = (target.origin[0], target.origin[1], target.origin[2])
    back = along(point, eye, jnp.asarray(-1.0, dtype))
    blocked, _ = intersect(world.solids, eye, back)
    px = target.focal[0] * back[0] / back[2] + target.principal[0]
    py = target.focal[1] * back[1] / back[2] + target.principal[1]
    inside = (px >= -0.5) & (px <= width - 0.5) & (py >= -0.5) & (py <= height - 0.5)
    return (inside & (blocked > 1.0 - 1e-4)).reshape(size)


def visibility(
    scene: Scene,
    *,
    shape: tuple[int, int, int, int],
    source: tuple[int, int],
    target: tuple[int, int],
) -> Bool[Array, "y x"]:
    """Which pixel centres of one view another view sees too: the exact occlusion mask.

    Args:
        scene: what was rendered.
        shape: as for `render`.
        source: `(v, u)` of the view whose pixels are asked about.
        target: `(v, u)` of the view that may see them.

    Returns:
        True where the surface point is inside the target's frame and nothing is in front of it.

    Raises:
        ValueError: if a view is outside of the grid.
    """
    _check_shape(shape, "view rows, view columns, height, width")
    for name, (v, u) in (("source", source), ("target", target)):
        if not (0 <= v < shape[0] and 0 <= u < shape[1]):
            raise ValueError(
                f"`{name}` must be a view of the {shape[0]}x{shape[1]} grid, got ({v}, {u})."
            )
    first, second = _grid_pinhole(scene, shape, *source), _grid_pinhole(scene, shape, *target)
    return _sees(scene.world, first, second, size=(int(shape[2]), int(shape[3])))
