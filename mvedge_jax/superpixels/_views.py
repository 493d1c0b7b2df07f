"""Labels of all views from those of the center view: each surface is labeled once."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from mvedge_jax.image import components
from mvedge_jax.warping import forward_warp, holes

from ._clusters import shifted

_BESIDE = ((0, 1), (0, -1), (1, 0), (-1, 0))
_AROUND = tuple((dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx)
# Rounds in which unmatched pixels of a view take the label of a neighbor.
_FILLS = 3


class Canvas(NamedTuple):
    """Surfaces in the coordinates of the center view, with a margin around its frame.

    `front` is the disparity of the surface in the center view, NaN beyond its frame; `back` that of
    the nearest surface that only other views show, NaN without one. Labels are 0 for none.
    """

    front: Float[Array, "h w"]
    back: Float[Array, "h w"]
    front_labels: Int[Array, "h w"]
    back_labels: Int[Array, "h w"]


def canvas_of(
    disparities: Float[Array, "v u y x"],
    labels: Int[Array, "y x"],
    step: Float[Array, ""],
    *,
    margin: int,
) -> Canvas:
    """Surfaces that only other views show, without labels, and the center view's with theirs.

    Two surfaces differ by more than `step`, px per view step.
    """
    rows, columns = disparities.shape[:2]
    wide = ((margin, margin), (margin, margin))
    center = disparities[rows // 2, columns // 2]
    front = jnp.pad(center, wide, constant_values=jnp.nan)

    def add(back: Array, item: tuple[Array, Array]) -> tuple[Array, None]:
        disparity, view = item
        place = _place(disparity, view, front.shape, margin)
        other = ~(jnp.abs(front.ravel()[place] - disparity) <= step)
        value = jnp.where(other & jnp.isfinite(disparity), disparity, -jnp.inf)
        return back.at[place].max(value, mode="promise_in_bounds"), None

    start = jnp.full(front.size, -jnp.inf, center.dtype)
    back, _ = lax.scan(add, start, _items(disparities))
    back = jnp.where(jnp.isfinite(back), back, jnp.nan).reshape(front.shape)
    front_labels = jnp.pad(labels, wide)
    return Canvas(front, back, front_labels, jnp.zeros_like(front_labels))


def _items(disparities: Array) -> tuple[Array, Array]:
    """Maps and steps `(u_c - u, v_c - v)` of all views, one after the other."""
    rows, columns, height, width = disparities.shape
    v, u = jnp.indices((rows, columns))
    steps = jnp.stack([columns // 2 - u, rows // 2 - v], axis=-1).reshape(-1, 2)
    return disparities.reshape(-1, height, width), steps.astype(disparities.dtype)


def _place(disparity: Array, view: Array, shape: tuple[int, ...], margin: int) -> Array:
    """Flat index in the canvas of the surface that each pixel of a view shows."""
    height, width = disparity.shape
    dtype = disparity.dtype
    shift = jnp.where(jnp.isfinite(disparity), disparity, 0)
    x = jnp.floor(jnp.arange(width, dtype=dtype)[None] - view[0] * shift + 0.5)
    y = jnp.floor(jnp.arange(height, dtype=dtype)[:, None] - view[1] * shift + 0.5)
    column = jnp.clip(x.astype(jnp.int32) + margin, 0, shape[1] - 1)
    row = jnp.clip(y.astype(jnp.int32) + margin, 0, shape[0] - 1)
    return row * shape[1] + column


def continued(
    canvas: Canvas,
    count: Int[Array, ""],
    step: Float[Array, ""],
    least: Float[Array, ""],
    *,
    capacity: int,
) -> tuple[Canvas, Int[Array, ""]]:
    """Labels surfaces hidden from the center view, by the same surface around or with new labels.

    Surfaces of fewer than `least` pixels get no new label. Returns the canvas and the new count of
    labels, which may exceed the capacity.
    """
    back = canvas.back
    there = jnp.isfinite(back)

    def grow(state: tuple[Array, Array]) -> tuple[Array, Array]:
        labels, _ = state
        known = (canvas.front, canvas.front_labels), (back, labels)
        found = _of_neighbors(back, known, step)
        found = jnp.where((labels == 0) & there, found, labels)
        return found, jnp.any(found != labels)

    labels, _ = lax.while_loop(lambda s: s[1], grow, (canvas.back_labels, jnp.asarray(True)))
    left = there & (labels == 0)

    def linked(dy: int, dx: int) -> Array:
        same = jnp.abs(shifted(back, dy, dx, jnp.nan) - back) <= step
        return same & left & shifted(left, dy, dx, False)

    root = components(linked(0, 1), linked(1, 0))
    size = jnp.zeros(root.size, jnp.int32).at[root.ravel()].add(left.ravel().astype(jnp.int32))
    first = size.astype(least.dtype) >= jnp.maximum(least, 1)
    rank = jnp.cumsum(first, dtype=jnp.int32) + count
    new = jnp.where(left & first[root], rank[root], 0)
    new = jnp.where(new <= capacity, new, 0)
    return canvas._replace(back_labels=jnp.where(left, new, labels)), rank[-1]


def _of_neighbors(
    disparity: Float[Array, "y x"],
    known: Sequence[tuple[Float[Array, "y x"], Int[Array, "y x"]]],
    limit: Float[Array, ""],
) -> Int[Array, "y x"]:
    """Label of the neighbor with the most similar disparity; 0 if none is within a limit.

    Of the `known` maps of disparities and labels, the first among equals wins.
    """
    found, gap = jnp.zeros_like(known[0][1]), jnp.full_like(disparity, jnp.inf)
    for depth, labels in known:
        for offset in _AROUND:
            difference = jnp.abs(shifted(depth, *offset, jnp.nan) - disparity)
            label = shifted(labels, *offset, 0)
            take = (label > 0) & (difference <= limit) & (difference < gap)
            gap = jnp.where(take, difference, gap)
            found = jnp.where(take, label, found)
    return found


def labeled(
    disparities: Float[Array, "v u y x"],
    labels: Int[Array, "y x"],
    canvas: Canvas,
    step: Float[Array, ""],
    fragment: Float[Array, ""],
    *,
    margin: int,
    capacity: int,
) -> Int[Array, "v u y x"]:
    """Labels of all views: those of the surfaces that their pixels show, by their disparity.

    Pieces with fewer than `fragment` pixels, separate from the rest of their label, join a
    neighbor.
    """
    front, back, front_labels, back_labels = (a.ravel() for a in canvas)
    center = disparities[disparities.shape[0] // 2, disparities.shape[1] // 2]

    def one(item: tuple[Array, Array]) -> Array:
        disparity, view = item
        place = _place(disparity, view, canvas.front.shape, margin)
        in_front = jnp.abs(front[place] - disparity) <= step
        behind = jnp.abs(back[place] - disparity) <= step
        label = jnp.where(in_front, front_labels[place], jnp.where(behind, back_labels[place], 0))
        label = _filled(label, disparity)
        # An outline that is wider in this view than in the center view is cut to the latter.
        moved = forward_warp(labels[..., None].astype(disparity.dtype), center, view)
        wide = moved.hit & ~in_front & (moved.disparity < disparity - step)
        label = jnp.where(wide, moved.image[..., 0].astype(jnp.int32), label)
        return whole(label, disparity, fragment, capacity + 1)

    maps = lax.map(one, _items(disparities)).reshape(disparities.shape)
    # Which it is itself, but for what has no label.
    return maps.at[disparities.shape[0] // 2, disparities.shape[1] // 2].set(labels)


def _filled(labels: Int[Array, "y x"], disparity: Float[Array, "y x"]) -> Int[Array, "y x"]:
    """Gives pixels without a label that of the neighbor with the most similar disparity."""
    finite, endless = jnp.isfinite(disparity), jnp.asarray(jnp.inf, disparity.dtype)

    def lacking(labels: Array) -> Array:
        return (labels == 0) & finite

    def fill(state: tuple[Array, Array]) -> tuple[Array, Array]:
        rounds, labels = state
        found = _of_neighbors(disparity, ((disparity, labels),), endless)
        return rounds + 1, jnp.where(lacking(labels), found, labels)

    def going(state: tuple[Array, Array]) -> Array:
        return (state[0] < _FILLS) & jnp.any(lacking(state[1]))

    def from_behind(labels: Array) -> Array:
        return labels.ravel()[holes(disparity, labels > 0).behind]

    _, labels = lax.while_loop(going, fill, (jnp.asarray(0, jnp.int32), labels))
    # Rarely needed, and more expensive than all the rest.
    labels = lax.cond(jnp.any(lacking(labels)), from_behind, lambda kept: kept, labels)
    return jnp.where(finite, labels, 0)


def whole(
    labels: Int[Array, "y x"],
    disparity: Float[Array, "y x"],
    fragment: Float[Array, ""],
    count: int,
) -> Int[Array, "y x"]:
    """Gives fragments of labels to the neighbor that is closest in disparity.

    Fragments are pieces of fewer than `fragment` pixels, but for the largest one of each label;
    `count` labels, 0 included.
    """
    root, area = _small_pieces(labels, fragment)
    name = labels.ravel()
    most = jnp.zeros(count, jnp.int32).at[name].max(area)[name]
    apart = (area < most) & (area.astype(fragment.dtype) < fragment)
    apart = apart.reshape(labels.shape)
    # The neighbor closest to the fragment as a whole, so that it is not split again.
    gap, options = jnp.full_like(disparity, jnp.inf), []
    for offset in _BESIDE:
        difference = jnp.abs(shifted(disparity, *offset, jnp.nan) - disparity)
        label = jnp.where(shifted(apart, *offset, True), 0, shifted(labels, *offset, 0))
        difference = jnp.where(apart & (label > 0), difference, jnp.inf)
        options.append((difference, label))
        gap = jnp.minimum(gap, difference)
    gap = jnp.full(root.size, jnp.inf, disparity.dtype).at[root].min(gap.ravel())[root]
    least, gap = jnp.full_like(labels, count), gap.reshape(labels.shape)
    for difference, label in options:
        chosen = jnp.isfinite(difference) & (difference == gap)
        least = jnp.where(chosen, jnp.minimum(label, least), least)
    best = jnp.full(root.size, count, jnp.int32).at[root].min(least.ravel())
    found = best[root].reshape(labels.shape)
    return jnp.where(apart & (found < count), found, labels)


def _small_pieces(labels: Int[Array, "y x"], fragment: Float[Array, ""]) -> tuple[Array, Array]:
    """Connected pieces of fewer pixels than `fragment`: a number for each, and its pixels; flat.

    Numbers spread only as far as the extent of such a piece. A number that is still spreading then
    belongs to a larger piece, which gets the size of the whole view.
    """
    size, fill = labels.size, labels.size
    links = [(offset, labels == shifted(labels, *offset, -1)) for offset in _BESIDE]

    def spread(_, least: Array) -> Array:
        found = least
        for offset, link in links:
            # Of the last step, not of this one: four shifts are read then, not all chains of them.
            other = shifted(least, *offset, fill)
            found = jnp.where(link, jnp.minimum(found, other), found)
        return found

    steps = jnp.clip(jnp.ceil(fragment), 1, size).astype(jnp.int32)
    start = jnp.arange(size, dtype=jnp.int32).reshape(labels.shape)
    least = lax.fori_loop(0, steps, spread, start)
    going_on = jnp.zeros_like(labels, bool)
    for offset, link in links:
        going_on |= link & (shifted(least, *offset, fill) != least)
    root = least.ravel()
    pixels = jnp.zeros(size, jnp.int32).at[root].add(jnp.where(going_on, size, 1).ravel())
    return root, jnp.minimum(pixels, size)[root]
