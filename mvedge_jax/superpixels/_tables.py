"""Tables of superpixels: position, plane, color, neighbors."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax.lightfield import LightField

from ._clustering import SuperpixelClustering
from ._clusters import Clusters, Surface, means, shifted, updated
from ._views import Canvas


class Tables(NamedTuple):
    """One row per label; `Superpixels` documents the columns."""

    xy: Float[Array, "k 2"]
    plane: Float[Array, "k 3"]
    color: Float[Array, "k 3"]
    area: Int[Array, " k"]
    parents: Int[Array, " k"]
    neighbors: Int[Array, "m 2"]
    linked: Bool[Array, " m"]


def tables_of(
    light_field: LightField,
    labels: Int[Array, "v u y x"],
    surface: Surface,
    canvas: Canvas,
    model: SuperpixelClustering,
    *,
    margin: int,
    capacity: int,
) -> Tables:
    """Tables of superpixels in the center view and, from the canvas, of those in other views."""
    vc, uc = light_field.center
    center, dtype = labels[vc, uc], surface.disparity.dtype
    area = jnp.zeros(capacity + 1, jnp.int32).at[center].add(1)[1:]
    xy, plane = _planes(surface.xy, surface.disparity, surface.lab, center, model, capacity)

    rows, columns = jnp.indices(canvas.back.shape)
    place = jnp.stack([columns - margin, rows - margin], axis=-1).astype(dtype)
    back = jnp.where(canvas.back_labels > 0, canvas.back, 0)
    nothing = jnp.zeros((*back.shape, 3), dtype)
    hidden = _planes(place, back, nothing, canvas.back_labels, model, capacity)
    seen = (area > 0)[:, None]
    xy, plane = jnp.where(seen, xy, hidden[0]), jnp.where(seen, plane, hidden[1])

    def add(sums: Array, item: tuple[Array, ...]) -> tuple[Array, None]:
        view, label, own, there = item
        counts = (own | (area[label - 1] == 0)) & (label > 0) & there
        row = jnp.where(counts, label - 1, capacity)
        values = jnp.concatenate([view, jnp.ones_like(view[..., :1])], axis=-1)
        return sums.at[row].add(values, mode="drop"), None

    grid = light_field.available.size
    items = (
        light_field.views.reshape(grid, *light_field.views.shape[2:]),
        labels.reshape(grid, *center.shape),
        jnp.arange(grid) == grid // 2,
        light_field.available.ravel(),
    )
    sums, _ = lax.scan(add, jnp.zeros((capacity, 4), dtype), items)
    color = sums[:, :3] / jnp.maximum(sums[:, 3:], 1)
    neighbors, linked = _touching(center, surface, capacity)
    return Tables(xy, plane, color, area, _parents(neighbors, linked, capacity), neighbors, linked)


def _planes(
    place: Array,
    disparity: Array,
    lab: Array,
    labels: Array,
    model: SuperpixelClustering,
    capacity: int,
) -> tuple[Array, Array]:
    """Mean positions and planes of labels."""
    which = jnp.where(labels > 0, labels - 1, 0)
    weights = (labels > 0).astype(disparity.dtype)
    # All pixels of a label are on its surface.
    every = eqx.tree_at(lambda p: p.limit, model, jnp.full_like(model.limit, jnp.inf))
    start = Clusters(*(jnp.zeros((capacity, n), disparity.dtype) for n in (2, 3, 3)))
    known = Surface(place, lab, disparity, jnp.zeros((4, *labels.shape), bool))
    found = start
    # First the positions; then sums about these, because sums about distant points lose precision.
    for _ in range(2):
        found = means(found, updated(known, found, weights, which, every), every)
    return found.xy, found.plane


def _touching(labels: Array, surface: Surface, capacity: int) -> tuple[Array, Array]:
    """Pairs of labels that touch in the center view, and whether without a depth step."""
    codes = []
    for link, offset in ((surface.links[0], (0, 1)), (surface.links[1], (1, 0))):
        other = shifted(labels, *offset, 0)
        small, large = jnp.minimum(labels, other), jnp.maximum(labels, other)
        pair = (small > 0) & (small < large)
        code = 2 * (small * (capacity + 1) + large) + jnp.where(link, 0, 1)
        codes.append(jnp.where(pair, code, jnp.iinfo(jnp.int32).max).ravel())
    code = jnp.sort(jnp.concatenate(codes).astype(jnp.int32))
    pair, there = code // 2, code < jnp.iinfo(jnp.int32).max
    first = there & jnp.concatenate([jnp.ones(1, bool), pair[1:] != pair[:-1]])
    most = 4 * capacity
    row = jnp.where(first, jnp.cumsum(first, dtype=jnp.int32) - 1, most)
    both = jnp.stack([pair // (capacity + 1), pair % (capacity + 1)], axis=-1)
    neighbors = jnp.zeros((most, 2), jnp.int32).at[row].set(both, mode="drop")
    linked = jnp.zeros(most, bool).at[row].set(code % 2 == 0, mode="drop")
    return neighbors, linked


def _parents(neighbors: Array, linked: Array, capacity: int) -> Array:
    """The least label that each one is connected to by links."""
    one, two = (jnp.where(linked, neighbors[:, k], 0) for k in (0, 1))

    def spread(state: tuple[Array, Array]) -> tuple[Array, Array]:
        least, _ = state
        found = least.at[one].min(least[two]).at[two].min(least[one])
        found = found[found]
        return found, jnp.any(found != least)

    start = jnp.arange(capacity + 1, dtype=jnp.int32)
    return lax.while_loop(lambda s: s[1], spread, (start, jnp.asarray(True)))[0][1:]
