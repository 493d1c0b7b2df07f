"""Clusters of the center view's pixels, each with a position, a color and a slanted plane."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._cpu import no_fuse

from ._clustering import SuperpixelClustering

# A cluster reaches into its own cell of the grid and the eight around it.
_CELLS = tuple((dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1))
# One of each pair of opposite neighbors.
_HALF = ((0, 1), (1, 0), (1, 1), (1, -1))


class Surface(NamedTuple):
    """Features of the center view's pixels: position, px, CIELAB, disparity, px per view step.

    `links`: whether a pixel is on one surface with its neighbor to the right, below, below to the
    right, below to the left; False at the frame.
    """

    xy: Float[Array, "y x 2"]
    lab: Float[Array, "y x 3"]
    disparity: Float[Array, "y x"]
    links: Bool[Array, "4 y x"]


class Grid(NamedTuple):
    """Square cells over the center view: the row and column of each pixel's cell, its side, px."""

    rows: Int[Array, ""]
    columns: Int[Array, ""]
    home: Int[Array, "2 y x"]
    size: Float[Array, ""]


class Clusters(NamedTuple):
    """A padded set of clusters: mean position, px, mean color, CIELAB, and plane.

    A plane is the disparity at `xy` and its change per px along x and y.
    """

    xy: Float[Array, "k 2"]
    lab: Float[Array, "k 3"]
    plane: Float[Array, "k 3"]


def surface_of(
    lab: Float[Array, "y x 3"], disparity: Float[Array, "y x"], step: Float[Array, ""]
) -> Surface:
    """Collects the features of the center view's pixels."""
    rows, columns = jnp.indices(disparity.shape)
    xy = jnp.stack([columns, rows], axis=-1).astype(disparity.dtype)
    links = jnp.stack([_linked(disparity, step, *offset) for offset in _HALF])
    return Surface(xy, lab, disparity, links)


def shifted(image: Array, dy: int, dx: int, fill) -> Array:
    """The image's values at `(y + dy, x + dx)`; `fill` beyond the frame."""
    margin = ((max(-dy, 0), max(dy, 0)), (max(-dx, 0), max(dx, 0)))
    height, width = image.shape
    padded = jnp.pad(image, margin, constant_values=fill)
    return lax.slice(padded, (max(dy, 0), max(dx, 0)), (max(dy, 0) + height, max(dx, 0) + width))


def _linked(disparity: Array, step: Array, dy: int, dx: int) -> Array:
    """Whether neighbors are on one surface; a continued slope is not a step."""
    first, last = disparity, shifted(disparity, dy, dx, jnp.nan)
    jump = jnp.abs(last - first)
    before = jnp.abs(first - shifted(disparity, -dy, -dx, jnp.nan))
    after = jnp.abs(shifted(disparity, 2 * dy, 2 * dx, jnp.nan) - last)
    slope = jnp.minimum(before, after)
    # At the frame, where a side is missing, no slope is assumed.
    return jump <= step + jnp.where(jnp.isfinite(slope), 1.5 * slope, 0)


def grid_over(shape: tuple[int, int], size: Float[Array, ""], capacity: int) -> Grid:
    """At most `capacity` square cells of about a size; their borders are between pixels."""
    height, width = shape
    size = jnp.maximum(size, jnp.sqrt(jnp.asarray(height * width / capacity, size.dtype)))
    rows = jnp.maximum(jnp.round(height / size), 1)
    # Not by the width alone: equal rounding of rows and columns would skip many numbers of cells.
    columns = jnp.maximum(jnp.round(height * width / (size**2 * rows)), 1)
    fewer = jnp.maximum(rows - 1, 1)
    fit = rows * columns <= capacity
    columns = jnp.where(fit, columns, jnp.maximum(jnp.floor(capacity / fewer), 1))
    rows = jnp.where(fit, rows, fewer)
    y, x = (jnp.arange(n, dtype=size.dtype) + 0.5 for n in shape)
    row = jnp.minimum(jnp.floor(y * rows / height), rows - 1).astype(jnp.int32)
    column = jnp.minimum(jnp.floor(x * columns / width), columns - 1).astype(jnp.int32)
    home = jnp.stack(jnp.broadcast_arrays(row[:, None], column[None]))
    side = jnp.sqrt(height * width / (rows * columns))
    return Grid(rows.astype(jnp.int32), columns.astype(jnp.int32), home, side)


def seeded(surface: Surface, grid: Grid, capacity: int) -> Clusters:
    """One cluster at the middle of each cell."""
    height, width = surface.disparity.shape
    dtype = surface.disparity.dtype
    index = jnp.arange(capacity, dtype=jnp.int32)
    row, column = index // grid.columns, index % grid.columns
    y = (row.astype(dtype) + 0.5) * height / grid.rows.astype(dtype) - 0.5
    x = (column.astype(dtype) + 0.5) * width / grid.columns.astype(dtype) - 0.5
    at = (
        jnp.clip(jnp.round(y), 0, height - 1).astype(jnp.int32),
        jnp.clip(jnp.round(x), 0, width - 1).astype(jnp.int32),
    )
    flat = jnp.zeros((capacity, 2), dtype)
    plane = jnp.concatenate([surface.disparity[at][:, None], flat], axis=1)
    return Clusters(jnp.stack([x, y], axis=-1), surface.lab[at], plane)


def cell_of(grid: Grid, offset: Int[Array, "2"]) -> tuple[Int[Array, "y x"], Bool[Array, "y x"]]:
    """The cell at an offset from each pixel's own, and whether it exists."""
    row, column = grid.home[0] + offset[0], grid.home[1] + offset[1]
    inside = (row >= 0) & (row < grid.rows) & (column >= 0) & (column < grid.columns)
    return jnp.where(inside, row * grid.columns + column, 0), inside


def cell_offsets() -> Int[Array, "9 2"]:
    """Offsets from a pixel's cell to those whose clusters it may join."""
    return jnp.asarray(np.array(_CELLS), jnp.int32)


def distance(
    surface: Surface, clusters: Clusters, which: Int[Array, "y x"], size: Array,
    model: SuperpixelClustering,
) -> Float[Array, "y x"]:  # fmt: skip
    """Squared distance of each pixel to a cluster, in units of the size."""
    # Column by column, because gathering a row for every pixel takes twice as long.
    x, y = (surface.xy[..., k] - clusters.xy[:, k][which] for k in range(2))
    level, slope_x, slope_y = (clusters.plane[:, k][which] for k in range(3))
    predicted = level + (slope_x * x + slope_y * y)
    color = sum((surface.lab[..., k] - clusters.lab[:, k][which]) ** 2 for k in range(3))
    color = color / model.color**2
    depth = ((surface.disparity - predicted) / model.depth) ** 2
    near = (x**2 + y**2) / size**2
    return near + _bounded(color, model.limit)[0] + _bounded(depth, model.limit)[0]


def _bounded(square: Array, limit: Array) -> tuple[Array, Array]:
    """A square that levels off smoothly at a limit (Geman and McClure), and its slope."""
    share = 1 / (1 + square / limit)
    return square * share, share * share


def updated(
    surface: Surface,
    clusters: Clusters,
    weights: Float[Array, "y x"],
    which: Int[Array, "y x"],
    model: SuperpixelClustering,
) -> Float[Array, "k 15"]:
    """Sums over the pixels of each cluster, the input of `means`."""
    away = surface.xy - clusters.xy[which]
    plane = clusters.plane[which]
    residual = surface.disparity - plane[..., 0]
    off = residual - jnp.sum(plane[..., 1:] * away, axis=-1)
    # Pixels of another surface have nearly no weight in the plane.
    sure = weights * _bounded((off / model.depth) ** 2, model.limit)[1]
    x, y = away[..., 0], away[..., 1]
    first = weights[..., None] * jnp.concatenate(
        [jnp.ones_like(x)[..., None], away, surface.lab], axis=-1
    )
    second = sure[..., None] * jnp.stack(
        [jnp.ones_like(x), x, y, x * x, x * y, y * y, residual, x * residual, y * residual], -1
    )
    values = jnp.concatenate([first, second], axis=-1).reshape(-1, 15)
    sums = jnp.zeros((clusters.xy.shape[0], 15), values.dtype)
    return sums.at[which.ravel()].add(values, mode="promise_in_bounds")


def means(clusters: Clusters, sums: Float[Array, "k 15"], model: SuperpixelClustering) -> Clusters:
    """Next clusters; those without pixels stay as they are."""
    mass = sums[:, 0]
    there = mass > 1e-6
    each = jnp.where(there, mass, 1)[:, None]
    shift, lab = sums[:, 1:3] / each, sums[:, 3:6] / each
    n, x, y, xx, xy, yy, d, xd, yd = (sums[:, 6 + k] for k in range(9))
    fitted = n > 1e-6
    n = jnp.where(fitted, n, 1)
    # A prior holds slopes at 0 unless the pixels determine them.
    prior = (model.depth / model.slope) ** 2
    cxx, cyy = xx - x * x / n + prior, yy - y * y / n + prior
    cxy, cxd, cyd = xy - x * y / n, xd - x * d / n, yd - y * d / n
    determinant = cxx * cyy - cxy * cxy
    a, b = (cyy * cxd - cxy * cyd) / determinant, (cxx * cyd - cxy * cxd) / determinant
    # At the new position of the cluster.
    level = clusters.plane[:, 0] + (d - a * x - b * y) / n + a * shift[:, 0] + b * shift[:, 1]
    rise = clusters.plane[:, 0] + jnp.sum(clusters.plane[:, 1:] * shift, axis=1)
    kept = jnp.concatenate([rise[:, None], clusters.plane[:, 1:]], axis=1)
    plane = jnp.where(fitted[:, None], jnp.stack([level, a, b], axis=1), kept)
    held = there[:, None]
    return Clusters(
        jnp.where(held, clusters.xy + shift, clusters.xy),
        jnp.where(held, lab, clusters.lab),
        jnp.where(held, plane, clusters.plane),
    )


def clustered(
    surface: Surface,
    grid: Grid,
    model: SuperpixelClustering,
    rounds: Int[Array, ""],
    *,
    capacity: int,
) -> tuple[Int[Array, "y x"], Clusters]:
    """Clusters pixels by position, color and plane, with short contours.

    Returns:
        The cluster of every pixel, and the clusters.
    """
    offsets = cell_offsets()
    height, width = surface.disparity.shape
    odd = (jnp.indices((height, width)).sum(0) % 2).astype(bool)
    # Half of the pixels at a time: neighbors that change at once would swap forever.
    halves = jnp.stack([odd, ~odd])

    def one(_, state: tuple[Array, Clusters]) -> tuple[Array, Clusters]:
        labels, clusters = state

        def cost(offset: Array) -> tuple[Array, Array]:
            which, inside = cell_of(grid, offset)
            found = distance(surface, clusters, which, grid.size, model)
            return jnp.where(inside, found, jnp.inf), jnp.where(inside, which, -1)

        costs, names = lax.map(cost, offsets)

        def change(labels: Array, now: Array) -> tuple[Array, None]:
            around = no_fuse(_around, labels, surface.links, model.contour)
            return jnp.where(now, _best(costs, names, around), labels), None

        # A scan: unrolled, the first half would be recomputed for each neighbor in the second.
        labels, _ = lax.scan(change, labels, halves)
        sums = updated(surface, clusters, jnp.ones_like(surface.disparity), labels, model)
        return labels, means(clusters, sums, model)

    first, _ = cell_of(grid, jnp.zeros(2, jnp.int32))
    start = first, seeded(surface, grid, capacity)
    return lax.fori_loop(0, rounds, one, start)


def _best(costs: Array, names: Array, around: tuple[Array, Array]) -> Array:
    """The cluster of least cost, contours included, of every pixel; the first among equals."""
    weights, others = around

    def better(best: tuple[Array, Array], item: tuple[Array, Array]):
        value, name = item
        for weight, label in zip(weights, others, strict=True):
            value = value + jnp.where(label == name, 0, weight)
        take = value < best[0]
        return (jnp.where(take, value, best[0]), jnp.where(take, name, best[1])), None

    start = jnp.full(costs.shape[1:], jnp.inf, costs.dtype), names[0]
    return lax.scan(better, start, (costs, names), unroll=True)[0][1]


def _around(labels: Array, links: Array, contour: Array) -> tuple[Array, Array]:
    """Penalty of a contour towards each of eight neighbors, and their labels."""
    weights, others = [], []
    for (dy, dx), link in zip(_HALF, links, strict=True):
        # With these shares, contours have about the right length in all directions.
        share = contour * (0.4 if dy and dx else 0.6)
        for sign in (1, -1):
            here = link if sign == 1 else shifted(link, -dy, -dx, False)
            weights.append(jnp.where(here, share, 0))
            others.append(shifted(labels, sign * dy, sign * dx, -1))
    return jnp.stack(weights), jnp.stack(others)
