"""Front-to-back compositing of depth-sorted points, tile by tile, with a closed-form gradient."""

import typing
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from mvedge_jax._linear_map import linear_map
from mvedge_jax._product import product

from ._profile import absorption
from ._raster import SplatRaster

# A number format: the exponential of minus this is 0 in float64, too.
_GONE = 800.0


class Physics(NamedTuple):
    """The three numbers that the splat depends on."""

    inverse_label: Float[Array, ""]  # 1 / 2σ_S²
    inverse_weight: Float[Array, ""]  # 1 / 2σ_λ²
    thickness: Float[Array, ""]  # τ = ρ σ_Z √(2π), optical thickness through the center


class Rays(NamedTuple):
    """What the pixels see."""

    label: Float[Array, "t p"]
    weight: Float[Array, "t p"]
    transmittance: Float[Array, "t p"]


class Lists(NamedTuple):
    """Depth-sorted points of every tile, in groups of tiles with about equally many points."""

    points: Int[Array, "m"]  # concatenated lists of rows of the point table
    start: Int[Array, "g l"]
    length: Int[Array, "g l"]
    origin: Float[Array, "g l 2"]  # center of each tile


def _offsets(tile: int, dtype: jnp.dtype) -> Float[Array, "p 2"]:
    axis = jnp.arange(tile, dtype=dtype) - (tile - 1) / 2
    y, x = jnp.meshgrid(axis, axis, indexing="ij")
    return jnp.stack([x.ravel(), y.ravel()], axis=-1)


def _row(lists: Lists, start: Array, count: Array, k: Array, last: int) -> Array:
    """Point of rank `k` in each tile; tiles that have no such point get the empty last row."""
    row = lists.points[jnp.minimum(start + k, lists.points.shape[0] - 1)]
    return jnp.where(k < count, row, last)


def _geometry(point: Array, origin: Array, offsets: Array) -> Array:
    """Squared distances from one point per tile to the tile's pixels."""
    relative = point[:, :2] - origin
    dx = offsets[None, :, 0] - relative[:, 0:1]
    dy = offsets[None, :, 1] - relative[:, 1:2]
    return dx * dx + dy * dy


def _optical(square: Array, point: Array, physics: Physics) -> Array:
    """Optical thickness of one point per tile at the tile's pixels."""
    return physics.thickness * point[:, 4:5] * jnp.exp(-square * physics.inverse_label)


@partial(jax.custom_jvp, nondiff_argnums=(3,))
def composite(
    table: Float[Array, "n 5"], physics: Physics, lists: Lists, raster: SplatRaster
) -> Rays:
    """Composites the points of every tile front to back.

    One loop step adds the next point of every tile of a group, as a vector over tiles and pixels; a
    group's loop ends with its longest list, so nothing is padded to a capacity. Reverse mode walks
    the lists once more in the same order: what lies behind a point is the total minus what lies in
    front, so nothing is stored per candidate. Forward mode goes through the loop, and through the
    gradient's; reverse mode cannot go through either twice.

    Args:
        table: rows (x, y, label, weight, opacity); the last row is far outside and empty.
        physics: widths and thickness.
        lists: the tiles' points.
        raster: static choices.

    Returns:
        Σ Z a T, Σ λ T and the transmittance behind all points, per tile (in group order) and pixel.
    """
    return _forward(table, physics, lists, raster)


def _forward(table: Array, physics: Physics, lists: Lists, raster: SplatRaster) -> Rays:
    last = table.shape[0] - 1
    offsets = _offsets(raster.tile, table.dtype)
    lanes, pixels = lists.start.shape[1], offsets.shape[0]

    def group(args: tuple[Array, Array, Array]) -> Rays:
        start, count, origin = args

        def step(k: Array, rays: Rays) -> Rays:
            point = table[_row(lists, start, count, k, last)]
            square = _geometry(point, origin, offsets)
            optical = _optical(square, point, physics)
            absorbed, _, passed, _ = absorption(optical, raster.absorption)
            flat = jnp.exp(-jax.lax.integer_pow(_clipped(square, physics, raster), raster.order))
            return Rays(
                rays.label + rays.transmittance * absorbed * point[:, 2:3],
                rays.weight + rays.transmittance * flat * point[:, 3:4],
                rays.transmittance * passed,
            )

        zero = jnp.zeros((lanes, pixels), table.dtype)
        first = Rays(zero, zero, jnp.ones_like(zero))
        return jax.lax.fori_loop(0, jnp.max(count, initial=0), step, first)

    grouped = jax.lax.map(group, (lists.start, lists.length, lists.origin))
    return Rays(*(part.reshape(-1, pixels) for part in grouped))


def _clipped(square: Array, physics: Physics, raster: SplatRaster) -> Array:
    """r²/2σ_λ², at most where the weight is 0 in every format, so that powers stay finite."""
    return jnp.minimum(square * physics.inverse_weight, _GONE ** (1 / raster.order))


class _At(NamedTuple):
    """Where the compositing is differentiated."""

    table: Array
    physics: Physics
    lists: Lists
    rays: Rays


@composite.defjvp
def _tangent(raster: SplatRaster, primals: Any, tangents: Any) -> tuple[Rays, Rays]:
    table, physics, lists = primals
    rays = typing.cast(Rays, composite(table, physics, lists, raster))
    at = _At(table, physics, lists, rays)
    return rays, linear_map(partial(_push, raster), partial(_pull, raster), at, tangents[:2])


def _push(raster: SplatRaster, at: _At, moving: tuple[Array, Physics]) -> Rays:
    def run(table: Array, physics: Physics) -> Rays:
        return _forward(table, physics, at.lists, raster)

    return jax.jvp(run, (at.table, at.physics), moving)[1]


def _about(sums: Array, relative: Array) -> tuple[Array, Array, Array]:
    """Σ q (dx, dy), Σ q r² and Σ q about points from those about a tile's center."""
    first = sums[:, 1:3] - relative * sums[:, :1]
    second = (
        sums[:, 3]
        - 2 * jnp.sum(relative * sums[:, 1:3], axis=1)
        + jnp.sum(relative**2, axis=1) * sums[:, 0]
    )
    return first, second, sums[:, 0]


def _pull(raster: SplatRaster, at: _At, cotangent: Rays) -> tuple[Array, Physics]:
    table, physics, lists, rays = at
    last = table.shape[0] - 1
    offsets = _offsets(raster.tile, table.dtype)
    groups, lanes = lists.start.shape
    pixels = offsets.shape[0]
    # Sums over pixels of q, q dx, q dy and q r² follow from four moments about the tile center.
    moments = jnp.concatenate(
        [jnp.ones_like(offsets[:, :1]), offsets, jnp.sum(offsets**2, axis=1, keepdims=True)], axis=1
    )
    total = (
        cotangent.label * rays.label
        + cotangent.weight * rays.weight
        + cotangent.transmittance * rays.transmittance
    )

    def group(carry, args):
        gradient, scalars = carry
        start, count, origin, behind, ct_label, ct_weight = args

        def step(k: Array, state):
            gradient, scalars, behind, transmittance = state
            row = _row(lists, start, count, k, last)
            point = table[row]
            square = _geometry(point, origin, offsets)
            relative = point[:, :2] - origin
            optical = _optical(square, point, physics)
            absorbed, slope, passed, constant = absorption(optical, raster.absorption)
            u = _clipped(square, physics, raster)
            power = (
                jax.lax.integer_pow(u, raster.order - 1) if raster.order > 1 else jnp.ones_like(u)
            )
            flat = jnp.exp(-power * u)
            seen_label = transmittance * ct_label
            seen_weight = transmittance * ct_weight
            own_label = seen_label * absorbed
            own_weight = seen_weight * flat
            behind = behind - own_label * point[:, 2:3] - own_weight * point[:, 3:4]
            # dL/d(ln G), and dL/d(-r²/2σ_λ²)
            q = optical * (seen_label * point[:, 2:3] * slope - constant * behind)
            m = raster.order * power * own_weight * point[:, 3:4]

            real = (k < count).astype(table.dtype)[:, None]
            position_q, square_q, sum_q = _about(product(q, moments) * real, relative)
            position_m, square_m, _ = _about(product(m, moments) * real, relative)
            position = 2 * (
                physics.inverse_label * position_q + physics.inverse_weight * position_m
            )
            update = jnp.concatenate(
                [
                    position,
                    jnp.sum(own_label, axis=1, keepdims=True),
                    jnp.sum(own_weight, axis=1, keepdims=True),
                    (sum_q / jnp.where(point[:, 4] > 0, point[:, 4], 1))[:, None],
                ],
                axis=1,
            )
            gradient = gradient.at[row].add(update)
            scalars = scalars + jnp.stack([-jnp.sum(square_q), -jnp.sum(square_m), jnp.sum(sum_q)])
            return gradient, scalars, behind, transmittance * passed

        state = (gradient, scalars, behind, jnp.ones((lanes, pixels), table.dtype))
        gradient, scalars, _, _ = jax.lax.fori_loop(0, jnp.max(count, initial=0), step, state)
        return (gradient, scalars), None

    def split(x: Array) -> Array:
        return x.reshape(groups, lanes, pixels)

    initial = (jnp.zeros_like(table), jnp.zeros(3, table.dtype))
    inputs = (lists.start, lists.length, lists.origin)
    inputs += (split(total), split(cotangent.label), split(cotangent.weight))
    (gradient, scalars), _ = jax.lax.scan(group, initial, inputs)
    gradient = gradient.at[-1].set(0)
    return gradient, Physics(scalars[0], scalars[1], scalars[2] / physics.thickness)
