"""What color a surface has: procedural texture, lamp, surroundings, shadow, highlight."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ._intersect import Vector, along, dot
from ._noise import fractal_noise, hash_unit
from .world import Light, World

_GOLDEN = 2.39996323  # the golden angle, radians
_JOINT = 0.07  # width of the joint between bricks, of their height


class _Look(NamedTuple):
    """Everything about the solid that a ray hits; the last axis is the rays'."""

    center: Float[Array, "3 r"]
    axes: Float[Array, "3 3 r"]
    half: Float[Array, "3 r"]
    rounded: Float[Array, " r"]
    dark: Float[Array, "3 r"]
    light: Float[Array, "3 r"]
    accent: Float[Array, "3 r"]
    stretch: Float[Array, "3 r"]
    pattern: Float[Array, " r"]
    contrast: Float[Array, " r"]
    frequency: Float[Array, " r"]
    gain: Float[Array, " r"]
    size: Float[Array, " r"]
    aspect: Float[Array, " r"]
    tint: Float[Array, " r"]
    specular: Float[Array, " r"]
    shininess: Float[Array, " r"]
    mirror: Float[Array, " r"]


def _look_up(world: World, index: Int[Array, " r"]) -> _Look:
    """Gathers what shading needs, one column of the table at a time.

    The loop keeps XLA from fusing gathers into the arithmetic, which would then not be vectorized.
    """
    rows = lax.map(lambda column: column[index], world.surfaces.table)
    return _Look(
        rows[0:3],
        rows[3:12].reshape(3, 3, -1),
        rows[12:15],
        rows[15],
        rows[16:19],
        rows[19:22],
        rows[22:25],
        rows[25:28],
        *(rows[k] for k in range(28, 38)),
    )


def _scale(vector: Vector, factor: Array) -> Vector:
    return vector[0] * factor, vector[1] * factor, vector[2] * factor


def _pattern(look: _Look, seed: Array, u: Array, v: Array, footprint: Array) -> tuple[Array, Array]:
    """How much of the accent color a pattern shows, and the random number of its cell.

    Edges are softened over the pixel's footprint, so that they do not alias.
    """
    size, aspect, kind = look.size, look.aspect, look.pattern
    u, v = u / size, v / size
    soft = jnp.clip(footprint / size, 1e-4, 0.5)

    def step(signed: Array) -> Array:
        return jnp.clip(0.5 + signed / soft, 0.0, 1.0)

    def centerd(t: Array) -> Array:
        return jnp.abs(t - jnp.floor(t) - 0.5)

    row = jnp.floor(v)
    bricks = kind == 2
    across = jnp.where(bricks, u / aspect + 0.5 * (row - 2.0 * jnp.floor(0.5 * row)), u)
    column = jnp.floor(across)

    def parity(t: Array) -> Array:  # +1 and -1 in turn, softened
        return jnp.clip((0.25 - centerd(0.5 * t + 0.25)) * 2.0 / soft, -0.5, 0.5) * 2.0

    checks = 0.5 - 0.5 * parity(u) * parity(v)
    joint = jnp.minimum((0.5 - centerd(across)) * aspect, 0.5 - centerd(v))
    mortar = step(0.5 * _JOINT - joint)
    stripes = step(0.25 - centerd(v))
    du, dv = u - column - 0.5, v - row - 0.5
    dots = step(0.3 - jnp.sqrt(du * du + dv * dv + 1e-6))
    mask = jnp.where(kind == 1, checks, jnp.where(bricks, mortar, jnp.zeros_like(u)))
    mask = jnp.where(kind == 3, stripes, jnp.where(kind == 4, dots, mask))
    column = jnp.where(kind == 3, 0.0, column)
    return mask, hash_unit(column, row, seed, u.dtype)


def _windows(direction: Vector) -> Array:
    """Light that comes from two windows behind the camera, in a direction of unit length."""
    x, y, z = direction
    facing = jnp.maximum(-z, 0.05)
    p, q = x / facing, y / facing

    def window(cx: float, cy: float, width: float, height: float) -> Array:
        inside = jnp.minimum(width - jnp.abs(p - cx), height - jnp.abs(q - cy))
        return jnp.where(z < 0, jnp.clip(inside * 12.0, 0.0, 1.0), 0.0)

    return 2.2 * window(-0.9, -0.75, 0.3, 0.35) + 1.2 * window(0.8, -0.5, 0.18, 0.45)


class _Hit(NamedTuple):
    """Where rays meet solids.

    `local` is the point in the solid's own coordinates, where its texture lives; the normal points
    towards the camera; `u`, `v` is the place on the surface, meters.
    """

    local: Float[Array, "3 r"]
    normal: Vector
    u: Float[Array, " r"]
    v: Float[Array, " r"]


def _hit(look: _Look, point: Vector, direction: Vector) -> _Hit:
    """The point and the normal where rays hit, and where that is on the surface."""
    axes, half = look.axes, look.half
    shifted = tuple(p - look.center[k] for k, p in enumerate(point))
    local = lax.map(lambda a: sum(a[k] * shifted[k] for k in range(3)), axes)
    spine = jnp.clip(local[2], -half[2], half[2])
    inward = 1.0 / jnp.maximum(half[0], 1e-9)
    rounded = (local[0] * inward, local[1] * inward, (local[2] - spine) * inward)
    # A box is hit on the face whose plane is nearest; a plane has no other than its third.
    gaps = [jnp.abs(jnp.abs(local[k]) - half[k]) for k in range(3)]
    flat = half[2] <= 0.0
    on_x = (gaps[0] < gaps[1]) & (gaps[0] < gaps[2]) & ~flat
    on_y = (gaps[1] <= gaps[0]) & (gaps[1] < gaps[2]) & ~flat
    is_round = look.rounded > 0
    zero = jnp.zeros_like(local[0])
    normal_local = tuple(
        jnp.where(is_round, rounded[k], jnp.where(on, jnp.where(local[k] < 0, -1.0, 1.0), zero))
        for k, on in enumerate((on_x, on_y, ~on_x & ~on_y))
    )
    turned = lax.map(
        lambda a: sum(a[k] * normal_local[k] for k in range(3)), jnp.swapaxes(axes, 0, 1)
    )
    normal = (turned[0], turned[1], turned[2])
    away = jnp.where(dot(normal, direction) > 0, -1.0, 1.0).astype(local.dtype)
    normal = _scale(normal, away)
    u = jnp.where(on_x & ~is_round, local[2], local[0])
    v = jnp.where((on_y & ~is_round) | is_round, local[2], local[1])
    return _Hit(local, normal, u, v)


def _highlight(look: _Look, mirrored: Vector, lamp: Vector, arriving: Array) -> Array:
    """How much of a lamp's light is reflected towards the camera."""
    peak = jnp.maximum(dot(mirrored, lamp), 1e-6)
    return look.specular * arriving * jnp.exp(look.shininess * jnp.log(peak))


def _further_lamps(
    look: _Look, light: Light, normal: Vector, mirrored: Vector
) -> list[tuple[Array, Array]]:
    """How much of the light of each lamp beyond the first is scattered, and reflected."""
    found = []
    for x, y, z in light.fills[:, 0]:
        scattered = jnp.maximum(dot(normal, (x, y, z)), 0.0)
        lit = (scattered > 0).astype(scattered.dtype)
        found.append((scattered, _highlight(look, mirrored, (x, y, z), lit)))
    return found


def shade(
    world: World,
    origin: Vector,
    direction: Vector,
    distance: Float[Array, " r"],
    index: Int[Array, " r"],
    footprint: Float[Array, " r"],
    axis: Vector,
    visible: Float[Array, " r"],
) -> Float[Array, "3 r"]:
    """Light that comes back along rays, linear RGB.

    Loops over the three components stand where XLA would otherwise fuse the whole of the shading
    into each of them and compute it three times. `distance` and `index` are those of `intersect`,
    `footprint` is the width of a pixel there, meters, `visible` how much of the lamp's light
    arrives. Textures are filtered by the slant towards the camera's `axis`, not towards the ray, so
    that the views of a rig agree.
    """
    light = world.light
    missed = index < 0
    index = jnp.maximum(index, 0)
    distance = jnp.where(missed, 1.0, distance)
    point = along(origin, direction, distance)

    look = _look_up(world, index)
    hit = _hit(look, point, direction)
    normal = hit.normal

    # A slanted surface is seen through a longer footprint; the root is a compromise between the
    # two directions, supersampling does the rest.
    slant = jnp.maximum(jnp.abs(dot(normal, axis)), 0.1)
    footprint = footprint * lax.rsqrt(slant)

    seed = world.surfaces.seed + 31 * index
    grain = hit.local / look.stretch
    noise = fractal_noise(
        (grain[0], grain[1], grain[2]), look.frequency, look.gain, footprint, seed
    )
    mask, cell = _pattern(look, seed, hit.u, hit.v, footprint)
    blend = jnp.clip(0.5 + 0.75 * look.contrast * noise, 0.0, 1.0)
    accent = mask * (0.8 + 0.2 * blend)
    tint = 1.0 + look.tint * (cell - 0.5)

    # Lamp, and surroundings from above and below.
    lamp = (light.direction[0], light.direction[1], light.direction[2])
    facing = jnp.maximum(dot(normal, lamp), 0.0)
    lambert = facing * visible
    up = 0.5 - 0.5 * normal[1]
    length = jnp.sqrt(dot(direction, direction))
    view = _scale(direction, -1.0 / length)
    mirrored = along(_scale(view, jnp.full_like(distance, -1.0)), normal, 2.0 * dot(normal, view))
    shine = _highlight(look, mirrored, lamp, visible * (facing > 0).astype(distance.dtype))
    more = _further_lamps(look, light, normal, mirrored)
    mirror, around = look.mirror, 0.5 - 0.5 * mirrored[1]
    glow = mirror * _windows(mirrored)

    def channel(part: tuple[Array, ...]) -> Array:
        dark, bright, over, lamp, sky, ground, fills = part
        albedo = dark + (bright - dark) * blend
        albedo = (albedo + (over - albedo) * accent) * tint
        diffuse = albedo * (ground + (sky - ground) * up + lamp * lambert)
        reflected = mirror * (ground + (sky - ground) * around) + glow + shine * lamp
        for own, (scattered, shiny) in zip(fills, more, strict=True):
            diffuse = diffuse + albedo * own * scattered
            reflected = reflected + own * shiny
        return jnp.where(missed, sky, diffuse * (1.0 - mirror) + reflected)

    lights = light.color, light.sky, light.ground, light.fills[:, 1].T
    return lax.map(channel, (look.dark, look.light, look.accent, *lights))


def lamp_directions(light: Light, samples: int) -> Float[Array, "3 s"]:
    """Directions towards points of the lamp, one per supersample, in a sunflower spiral.

    Each supersample looks for shadow towards its own point: their average is a soft shadow.
    """
    dtype = light.direction.dtype
    count = jnp.arange(samples, dtype=dtype)
    radius = light.softness * jnp.sqrt((count + 0.5) / samples)
    x, y, z = light.direction
    first = jnp.stack([y, -x, jnp.zeros_like(x)])
    first = first / jnp.sqrt(x * x + y * y + 1e-9)
    second = jnp.stack([y * first[2] - z * first[1], z * first[0] - x * first[2], -x * x - y * y])
    second = second / jnp.sqrt(jnp.sum(second * second) + 1e-9)
    across = radius * jnp.cos(count * _GOLDEN)
    up = radius * jnp.sin(count * _GOLDEN)
    spread = first[:, None] * across[None] + second[:, None] * up[None]
    return light.direction[:, None] + spread
