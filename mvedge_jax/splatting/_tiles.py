"""The points of every tile of the raster, nearest first."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ._composite import Lists
from ._raster import SplatRaster


class Tiling(NamedTuple):
    """Lists of points per tile, and the order of the tiles."""

    lists: Lists
    place: Int[Array, "t"]  # position of every tile in the groups, row by row
    overflow: Int[Array, ""]  # entries beyond the capacity
    longest: Int[Array, ""]  # points in the fullest tile


def depth_order(
    label: Float[Array, "n"], usable: Bool[Array, "n"], nearest: str
) -> Int[Array, "n"]:
    """Indices of points from the nearest to the farthest, unusable ones last, ties by index."""
    key = -label if nearest == "largest" else label
    return jnp.argsort(jnp.where(usable, key, jnp.inf), stable=True)


def make_tiles(
    xy: Float[Array, "n 2"],
    usable: Bool[Array, "n"],
    shape: tuple[int, int],
    raster: SplatRaster,
) -> Tiling:
    """Lists, for every tile, the points whose disc of radius `raster.radius` meets it.

    Tiles are grouped by the length of their lists so that a group wastes little.

    Args:
        xy: raster positions in depth order.
        usable: points that take part.
        shape: raster height and width.
        raster: static choices.
    """
    n = xy.shape[0]
    tile, radius = raster.tile, raster.radius
    rows, columns = -(-shape[0] // tile), -(-shape[1] // tile)
    tiles = rows * columns
    span = -(-2 * radius // tile) + 1
    # Pixel k covers [k - ½, k + ½]; only pixel centers matter, so tile j covers [j t, j t + t - 1].
    safe = jnp.where(usable[:, None], xy, -4.0 * (radius + tile))
    limit = float(tile * (max(rows, columns) + span + 2))
    safe = jnp.clip(safe, -limit, limit)
    first = jnp.floor((safe - radius) / tile).astype(jnp.int32)
    step = jnp.arange(span, dtype=jnp.int32)[None]
    tx, ty = first[:, 0:1] + step, first[:, 1:2] + step  # [n span]

    def gap(index: Array, coordinate: Array) -> Array:
        low = (index * tile).astype(xy.dtype)
        outside = jnp.maximum(low - coordinate, coordinate - (low + (tile - 1)))
        return jnp.maximum(outside, 0) ** 2

    near = gap(tx, safe[:, 0:1])[:, None, :] + gap(ty, safe[:, 1:2])[:, :, None] <= radius**2
    inside = ((tx >= 0) & (tx < columns))[:, None, :] & ((ty >= 0) & (ty < rows))[:, :, None]
    member = near & inside & usable[:, None, None]
    identity = ty[:, :, None] * columns + tx[:, None, :]
    identity = jnp.where(member, identity, tiles).reshape(-1)
    rank = jnp.broadcast_to(jnp.arange(n, dtype=jnp.int32)[:, None, None], member.shape).reshape(-1)

    if (tiles + 1) * n < 2**32:
        # One unsigned number per entry sorts several times as fast as a pair.
        packed = jnp.sort(identity.astype(jnp.uint32) * jnp.uint32(n) + rank.astype(jnp.uint32))
        identity, rank = packed // jnp.uint32(n), (packed % jnp.uint32(n)).astype(jnp.int32)
        identity = identity.astype(jnp.int32)
    else:
        identity, rank = jax.lax.sort((identity, rank), num_keys=2)
    bounds = jnp.searchsorted(identity, jnp.arange(tiles + 1, dtype=jnp.int32)).astype(jnp.int32)
    start, length = bounds[:-1], jnp.diff(bounds)
    count = length if raster.capacity is None else jnp.minimum(length, raster.capacity)

    by_length = jnp.argsort(-count)
    place = jnp.argsort(by_length)
    lanes = min(raster.lanes, tiles)
    groups = -(-tiles // lanes)
    padding = groups * lanes - tiles
    column, row = by_length % columns, by_length // columns
    origin = jnp.stack([column, row], axis=-1).astype(xy.dtype) * tile + (tile - 1) / 2

    def grouped(x: Array) -> Array:
        padded = jnp.pad(x, [(0, padding)] + [(0, 0)] * (x.ndim - 1))
        return padded.reshape((groups, lanes, *x.shape[1:]))

    lists = Lists(rank, grouped(start[by_length]), grouped(count[by_length]), grouped(origin))
    return Tiling(lists, place, jnp.sum(length - count), jnp.max(length, initial=0))
