"""Tracing one view: rays, supersamples, blur and noise, in one jitted function."""

import math
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, PRNGKeyArray

from mvedge_jax._product import FULL

from ._intersect import Vector, along, intersect, intersect_and_shadow, rotate
from ._shade import lamp_directions, shade
from .world import Scene, Sensor, World

_RAYS = 16384  # traced at once: their intermediate arrays stay in the cache
_BLUR_REACH = 9  # px, three standard deviations of the widest blur


class Pinhole(eqx.Module):
    """A camera without distortion."""

    origin: Float[Array | np.ndarray, "3"]
    rotation: Float[Array | np.ndarray, "3 3"]  # camera to world; x right, y down, z forward
    focal: Float[Array | np.ndarray, "2"]
    principal: Float[Array | np.ndarray, "2"]


def tent(samples: int) -> np.ndarray:
    """Offsets, px, at equal quantiles of a tent of half width 1: samples of equal weight."""
    quantile = (np.arange(samples) + 0.5) / samples
    left = np.sqrt(2 * np.minimum(quantile, 1 - quantile)) - 1
    return np.where(quantile < 0.5, left, -left)


def rays(pinhole: Pinhole, x: Array, y: Array) -> tuple[Vector, Vector]:
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
        planes = lax.conv_general_dilated(planes, kernel, (1, 1), "VALID", precision=FULL)
    return jnp.moveaxis(planes[:, 0], 0, -1)


def _add_noise(image: Float[Array, "y x 3"], sensor: Sensor, key: PRNGKeyArray) -> Array:
    deviation = jnp.sqrt(sensor.read_noise**2 + sensor.shot_noise * image)
    return image + deviation * jax.random.normal(key, image.shape, image.dtype)


def _lens(size: tuple[int, int], sensor: Sensor, key: PRNGKeyArray) -> Float[Array, "y x"]:
    """What a lens of its own leaves of the brightness of every pixel."""
    dtype = sensor.vignette.dtype
    down, across, gain = jax.random.normal(key, (3,), dtype)
    shift = sensor.vignette_shift * min(size)
    y, x = (
        jnp.arange(n, dtype=dtype) - (n - 1) / 2 - shift * moved
        for n, moved in zip(size, (down, across), strict=True)
    )
    corner = sum(((n - 1) / 2) ** 2 for n in size)
    lost = sensor.vignette * (y[:, None] ** 2 + x[None] ** 2) / max(corner, 1)
    return jnp.maximum(1 - lost, 0) * jnp.maximum(1 + sensor.gain * gain, 0)


class Mode(NamedTuple):
    """What is compiled in; the rest of a scene is data."""

    size: tuple[int, int]
    samples: int
    exposed: bool  # blur, noise, vignettes, gains or quantization


def mode_of(scene: Scene, size: tuple[int, int], samples: int) -> Mode:
    s = scene.sensor
    changes = s.blur, s.read_noise, s.shot_noise, s.vignette, s.gain, s.levels
    return Mode(size, samples, exposed=any(float(x) > 0 for x in changes))


@partial(jax.jit, static_argnames=("mode",))
def trace_view(
    world: World,
    sensor: Sensor,
    pinhole: Pinhole,
    key: PRNGKeyArray,
    view: Int[Array, ""],
    *,
    mode: Mode,
) -> tuple[Array, Array, Array]:
    """Image, depth and ids of one view."""
    height, width = mode.size
    samples = mode.samples
    dtype = world.solids.center.dtype
    per_pixel = samples * samples
    # Tiles, nearly square and nearly equal: their rays pass by most solids.
    side = max(1, math.isqrt(_RAYS // per_pixel))
    down, across = -(-height // side), -(-width // side)
    tall, wide = -(-height // down), -(-width // across)
    offsets = jnp.asarray(tent(samples), dtype)
    dy, dx = (o.reshape(-1) for o in jnp.meshgrid(offsets, offsets, indexing="ij"))
    # The truth is that of the pixel's center: the middle sample, or one more if there is no middle.
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
        origin, direction = rays(pinhole, x.reshape(-1), y.reshape(-1))
        distance, hit, hidden = intersect_and_shadow(
            world.solids, origin, direction, (lamp_x, lamp_y, lamp_z), light.shadow > 0
        )
        depth = distance.reshape(-1, tall, wide)[middle]
        index = hit.reshape(-1, tall, wide)[middle]
        distance, hit, hidden = distance[:shaded], hit[:shaded], hidden[:shaded]
        visible = jnp.where(hidden, 1.0 - light.shadow, 1.0)
        direction = (direction[0][:shaded], direction[1][:shaded], direction[2][:shaded])
        footprint = jnp.where(hit < 0, 1.0, distance) / pinhole.focal.min()
        color = shade(world, origin, direction, distance, hit, footprint, axis, visible)
        return color.reshape(3, per_pixel, tall, wide).mean(1), depth, index

    def picture(tiles: Array) -> Array:
        whole = tiles.reshape(down, across, tall, wide).swapaxes(1, 2)
        return whole.reshape(down * tall, across * wide)[:height, :width]

    color, depth, index = lax.map(tile, jnp.arange(down * across, dtype=jnp.int32))
    depth, index = picture(depth), picture(index)
    image = jnp.stack([picture(color[:, c]) for c in range(3)], axis=-1)
    ids = jnp.where(index < 0, 0, world.solids.object_id[jnp.maximum(index, 0)])
    if mode.exposed:
        own = jax.random.fold_in(key, view)
        lens = _lens(mode.size, sensor, jax.random.fold_in(own, 1))
        image = _encode(_blur(image, sensor.blur)) * lens[..., None]
        image = jnp.clip(_add_noise(image, sensor, own), 0.0, 1.0)
        image = jnp.where(
            sensor.levels > 0, jnp.round(image * sensor.levels) / sensor.levels, image
        )
    else:
        image = _encode(image)
    return image, depth, ids


@partial(jax.jit, static_argnames=("size",))
def sees(world: World, source: Pinhole, target: Pinhole, *, size: tuple[int, int]) -> Array:
    height, width = size
    dtype = world.solids.center.dtype
    y, x = jnp.meshgrid(
        jnp.arange(height, dtype=dtype), jnp.arange(width, dtype=dtype), indexing="ij"
    )
    origin, direction = rays(source, x.reshape(-1), y.reshape(-1))
    depth, index = intersect(world.solids, origin, direction)
    point = along(origin, direction, jnp.where(index < 0, 1e4, depth))
    eye = (target.origin[0], target.origin[1], target.origin[2])
    back = along(point, eye, jnp.asarray(-1.0, dtype))
    blocked, _ = intersect(world.solids, eye, back)
    px = target.focal[0] * back[0] / back[2] + target.principal[0]
    py = target.focal[1] * back[1] / back[2] + target.principal[1]
    inside = (px >= -0.5) & (px <= width - 0.5) & (py >= -0.5) & (py <= height - 0.5)
    return (inside & (blocked > 1.0 - 1e-4)).reshape(size)
