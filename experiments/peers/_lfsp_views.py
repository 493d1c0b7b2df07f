"""Labels of EPI segments in all views: painted, propagated from the center, filled (5.1)."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from mvedge_jax.image import box_mean

from ._clustering import alike
from ._lfsp_painting import Ends, agreed, painted, smoothed_labels

# Windows of the propagation and of the last filling, px, and how often that may go on.
_REACH, _LAST, _FILLS = 10, 3, 12
# Weight of the squared distance in the last filling.
_CLOSE = 3.0
# The filter of colors before the propagation: radius, px, and variance that is half kept, Lab².
_RADIUS, _VARIANCE = 3, 75.0


class Field(NamedTuple):
    """Segments of one direction with their labels, from 1 on, and disparities."""

    ends: Ends
    disparity: Float[Array, " n"]
    label: Int[Array, " n"]


@partial(jax.jit, static_argnames=("shape", "widths", "median"))
def painted_views(
    fields: tuple[Field, Field],
    steps: Float[Array, "v u 2"],
    *,
    shape: tuple[int, int],
    widths: tuple[int, int],
    median: bool,
) -> tuple[Int[Array, "v u y x"], Float[Array, "v u y x"]]:
    """Labels and disparities of all views from both directions; 0 and NaN where they say nothing.

    Args:
        fields: of the EPIs along x, then of those along y.
        steps: of the views.
        shape: of a view.
        widths: of the segments of either direction, from `width_of`.
        median: smooth labels by the middle number.
    """

    def of(field: Field, width: int, step: Array, shape: tuple[int, int]) -> tuple[Array, Array]:
        index = painted(field.ends, field.disparity, step, shape=shape, width=width)
        known, index = index >= 0, jnp.maximum(index, 0)
        label = smoothed_labels(jnp.where(known, field.label[index], 0), middle=median)
        return label, jnp.where(known, field.disparity[index], jnp.nan)

    turned = shape[1], shape[0]

    def view(step: Array) -> tuple[Array, Array]:
        across, near = of(fields[0], widths[0], step, shape)
        down, other = (a.T for a in of(fields[1], widths[1], step[::-1], turned))
        disparity = jnp.where((across > 0) & jnp.isfinite(near), near, other)
        return agreed(across, down), disparity

    labels, disparity = lax.map(view, steps.reshape(-1, 2))
    return tuple(a.reshape(*steps.shape[:2], *shape) for a in (labels, disparity))


def _crosshair(rows: int, columns: int) -> np.ndarray:
    """Flat indices of the views of the crosshair, outwards: right, down, left, up."""
    middle = rows // 2, columns // 2
    order = [middle]
    for radius in range(1, max(middle) + 1):
        order += [
            (middle[0], middle[1] + radius),
            (middle[0] + radius, middle[1]),
            (middle[0], middle[1] - radius),
            (middle[0] - radius, middle[1]),
        ]
    there = [(v, u) for v, u in order if 0 <= v < rows and 0 <= u < columns]
    return np.array([v * columns + u for v, u in there], np.int32)


@partial(jax.jit, static_argnames=("swapped", "clamped"))
def propagated(
    labels: Int[Array, "v u y x"],
    disparity: Float[Array, "v u y x"],
    lab: Float[Array, "v u y x 3"],
    steps: Float[Array, "v u 2"],
    *,
    swapped: bool,
    clamped: bool,
) -> Int[Array, "v u y x"]:
    """Gives pixels without a label that of a pixel near them, and hands it to all views.

    Args:
        labels: of all views, 0 for none.
        disparity: of all views, NaN for none; read in the crosshair.
        lab: colors.
        steps: of the views.
        swapped: read the disparity of the other arm.
        clamped: let what leaves the frame land on its border.
    """
    rows, columns, height, width = labels.shape
    order = _crosshair(rows, columns)
    other = order % columns * columns + order // columns
    maps, flat = labels.reshape(-1, height, width), steps.reshape(-1, 2)
    depths, colors = disparity.reshape(maps.shape), lab.reshape(*maps.shape, 3)
    one = jnp.ones((), lab.dtype)

    def turn(maps: Array, item: tuple[Array, Array]) -> tuple[Array, None]:
        own, read = item
        label = maps[own]
        source = alike(label > 0, _guided(colors[own]), one, one, radius=_REACH)
        found = jnp.where(source < 0, 0, label.ravel()[source])
        depth = jnp.where(source < 0, jnp.nan, depths[read].ravel()[source])
        new = (label == 0) & (found > 0) & jnp.isfinite(depth)

        def push(item: tuple[Array, Array]) -> Array:
            there, step = item
            moved = _pushed(found, jnp.where(new, depth, jnp.nan), step - flat[own], clamped)
            return jnp.where(there == 0, moved, there)

        return lax.map(push, (maps, flat)).at[own].set(found), None

    maps, _ = lax.scan(turn, maps, (jnp.asarray(order), jnp.asarray(other if swapped else order)))
    filled = lax.map(lambda item: _filled(*item), (maps, colors))
    return filled.reshape(labels.shape)


def _guided(lab: Float[Array, "y x 3"]) -> Float[Array, "y x 3"]:
    """Colors smoothed where they vary little: each channel guides itself."""
    image = jnp.moveaxis(lab, -1, 0)
    mean = box_mean(image, _RADIUS)
    variance = jnp.maximum(box_mean(image**2, _RADIUS) - mean**2, 0)
    share = variance / (variance + _VARIANCE)
    smooth = box_mean(share, _RADIUS) * image + box_mean((1 - share) * mean, _RADIUS)
    return jnp.moveaxis(smooth, 0, -1)


def _pushed(labels: Array, disparity: Array, step: Array, clamped: bool) -> Array:
    """Labels of pixels with a disparity where another view has them, nearest on top; 0 for none."""
    height, width = labels.shape
    still = jnp.where(jnp.isfinite(disparity), disparity, 0)
    x = jnp.floor(jnp.arange(width, dtype=still.dtype)[None] + step[0] * still + 0.5)
    y = jnp.floor(jnp.arange(height, dtype=still.dtype)[:, None] + step[1] * still + 0.5)
    stays = jnp.isfinite(disparity)
    if clamped:
        x, y = jnp.clip(x, 0, width - 1), jnp.clip(y, 0, height - 1)
    else:
        stays &= (x >= 0) & (x < width) & (y >= 0) & (y < height)
    place = jnp.where(stays, y.astype(jnp.int32) * width + x.astype(jnp.int32), labels.size)
    near = jnp.full(labels.size + 1, -jnp.inf, still.dtype).at[place].max(still)
    wins = jnp.where(stays & (still == near[place]), labels, 0)
    return jnp.zeros(labels.size + 1, jnp.int32).at[place].max(wins)[:-1].reshape(labels.shape)


def _filled(labels: Int[Array, "y x"], lab: Float[Array, "y x 3"]) -> Int[Array, "y x"]:
    """Fills what is left from close by, again while that reaches further."""
    one = jnp.ones((), lab.dtype)

    def fill(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        count, labels, _ = state
        source = alike(labels > 0, lab, _CLOSE * one, one, radius=_LAST)
        found = jnp.where(source < 0, 0, labels.ravel()[source])
        return count + 1, found, jnp.any(found != labels)

    def going(state: tuple[Array, Array, Array]) -> Array:
        return (state[0] < _FILLS) & state[2]

    start = jnp.asarray(0, jnp.int32), labels, jnp.any(labels == 0)
    return lax.while_loop(going, fill, start)[1]
