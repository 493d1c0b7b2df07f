"""Reading all views of a light field around a map, not those of the crosshair alone."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import cast
from mvedge_jax.image import box_mean, cubic_taps, spline_coefficients

from ._look import Look
from ._measuring import Measuring

# What the taps of a spline reach beyond the pixel before a position.
_BEFORE, _AFTER = 1, 2


class Grid(NamedTuple):
    """All views of a light field, made ready for being read between their pixels.

    Attributes:
        splines: coefficients of cubic splines, `[s, y, x]`; every row is longer than the images'
            by 3 px and has its channels side by side.
        steps: `(u_c - u, v_c - v)` of every view, `[s, 2]`.
        available: views that are there, `[s]`.
    """

    splines: Float[Array, "s h w"]
    steps: Float[Array, "s 2"]
    available: Bool[Array, " s"]


def grid_of(
    views: Float[Array, "s c y x"], steps: Float[Array, "s 2"], available: Bool[Array, " s"]
) -> Grid:
    """Makes views ready for `look_around`.

    Args:
        views: the centre view among them, exposure and gains taken out.
        steps: `(u_c - u, v_c - v)` of every view.
        available: views that are there.

    Returns:
        The grid. Differentiable.
    """

    def one(view: Array) -> Array:
        both = spline_coefficients(spline_coefficients(view, axis=-1), axis=-2)
        last = jnp.moveaxis(both, 0, -1)
        margin = (_BEFORE, _AFTER)
        padded = jnp.pad(last, (margin, margin, (0, 0)), mode="edge")
        return padded.reshape(padded.shape[0], -1)

    return Grid(lax.map(one, views), steps.astype(views.dtype), available)


class _Totals(NamedTuple):
    """Sums over the views: weights, steps, their products, colours, their products with steps."""

    n: Array
    x: Array
    y: Array
    xx: Array
    xy: Array
    yy: Array
    r: Array
    rx: Array
    ry: Array
    rr: Array


@partial(jax.jit, static_argnames="radius")
def look_around(
    grid: Grid, disparity: Float[Array, "y x"], params: Measuring, *, radius: int
) -> Look:
    """Reads colours and gradients of all views around a map: `look`, for a grid of views.

    Args:
        grid: of all views, see `grid_of`.
        disparity: px per view step, `[y, x]`.
        params: see `Measuring`.
        radius: how far occluders are looked for, px.

    Returns:
        What `labels` and `mismatch` read. Differentiable.
    """
    params = cast(params, disparity.dtype)
    own = grid._replace(splines=grid.splines[_centre(grid)])
    reference, *_ = _sample(own.splines, disparity, jnp.zeros(2, disparity.dtype))

    @jax.checkpoint
    def read(total: tuple[Array, ...], view: tuple[Array, Array, Array]):
        spline, step, there = view
        seen = _seen(disparity, step, radius) & there
        weight = seen.astype(disparity.dtype)
        value, slope_x, slope_y = _sample(spline, disparity, step)
        relative = value - reference
        w = weight[None]
        terms = (weight, w * relative, w * relative**2, w * slope_x, w * slope_y)
        return tuple(t + new for t, new in zip(total, terms, strict=True)), (weight, relative)

    zero, zeros = jnp.zeros_like(disparity), jnp.zeros_like(reference)
    (count, colour, square, gx, gy), seen = lax.scan(read, (zero, *[zeros] * 4), grid)
    mean, gx, gy = (part / count[None] for part in (colour, gx, gy))
    spread = _total(square / count[None] - mean**2)
    floor = reference.shape[0] * params.noise**2
    scale = params.outlier * jnp.maximum(box_mean(spread, 1), floor)

    @jax.checkpoint
    def add(total: _Totals, view: tuple[Array, Array, Array]) -> tuple[_Totals, None]:
        weight, relative, step = view
        relative = relative - mean
        weight = weight / (1 + box_mean(_total(relative**2), 1) / scale)
        x, y = step
        w = weight[None]
        new = _Totals(
            weight, weight * x, weight * y, weight * x * x, weight * x * y, weight * y * y,
            w * relative, w * x * relative, w * y * relative, w * relative**2,
        )  # fmt: skip
        return jax.tree.map(jnp.add, total, new), None

    start = _Totals(*[zero] * 6, *[zeros] * 4)
    total, _ = lax.scan(add, start, (*seen, grid.steps))
    return _look(total, gx, gy, jnp.sum(grid.available.astype(disparity.dtype)))


def _look(total: _Totals, gx: Array, gy: Array, views: Array) -> Look:
    n, x, y, r = total.n, total.x, total.y, total.r
    xx, xy, yy = total.xx - x * x / n, total.xy - x * y / n, total.yy - y * y / n
    rx, ry = total.rx - (x / n)[None] * r, total.ry - (y / n)[None] * r
    along_x, along_y = xx[None] * gx + xy[None] * gy, xy[None] * gx + yy[None] * gy
    return Look(
        right=-_total(gx * rx + gy * ry),
        information=_total(gx * along_x + gy * along_y),
        power=_total(total.rr - r * r / n[None]),
        freedom=n - 1,
        views=views,
        spread=(xx, yy),
        cross=xy,
        slope=(tuple(along_x), tuple(along_y)),
        trend=(tuple(rx), tuple(ry)),
    )


def _centre(grid: Grid) -> Array:
    return jnp.argmin(jnp.sum(jnp.abs(grid.steps), axis=1))


def _total(planes: Float[Array, "c y x"]) -> Float[Array, "y x"]:
    """Sum over channels, by hand: XLA on CPU does not vectorise one over a leading axis."""
    total = planes[0]
    for plane in planes[1:]:
        total = total + plane
    return total


def _seen(
    disparity: Float[Array, "y x"], step: Float[Array, "2"], radius: int
) -> Bool[Array, "y x"]:
    """Pixels that a view shows: within its frame, and not behind anything nearer.

    What lies `j` px away against the direction of the view's step hides a pixel if it is nearer by
    `j` over the length of the step; half a pixel and half a step are the pixels' own size.
    """
    disparity = lax.stop_gradient(disparity)
    height, width = disparity.shape
    length = jnp.max(jnp.abs(step))
    direction = step / jnp.maximum(length, 1)
    padded = jnp.pad(disparity, radius, constant_values=-jnp.inf)

    def nearer(hidden: Array, distance: Array) -> tuple[Array, None]:
        apart = distance.astype(disparity.dtype)
        x, y = (jnp.round(apart * d).astype(jnp.int32) for d in direction)
        other = lax.dynamic_slice(padded, (radius - y, radius - x), (height, width))
        return hidden | ((other - disparity) * (length + 0.5) > apart - 0.5), None

    nothing = jnp.zeros(disparity.shape, bool)
    hidden, _ = lax.scan(nearer, nothing, jnp.arange(1, radius + 1))
    hidden = hidden & (length > 0)
    x, y = _positions(disparity, step)
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    return inside & ~hidden


def _positions(disparity: Array, step: Array) -> tuple[Array, Array]:
    height, width = disparity.shape
    x = jnp.arange(width, dtype=disparity.dtype)[None] + step[0] * disparity
    y = jnp.arange(height, dtype=disparity.dtype)[:, None] + step[1] * disparity
    return x, y


def _sample(
    spline: Float[Array, "h w"], disparity: Float[Array, "y x"], step: Float[Array, "2"]
) -> tuple[Float[Array, "c y x"], Float[Array, "c y x"], Float[Array, "c y x"]]:
    """A view where it shows the pixels, and its derivatives along x and y."""
    height, width = disparity.shape
    row_length = spline.shape[1]
    channels = row_length // (width + _BEFORE + _AFTER)
    x, y = _positions(disparity, step)
    x, y = jnp.clip(x, 0, width - 1), jnp.clip(y, 0, height - 1)
    column, row = jnp.floor(x), jnp.floor(y)
    (wx, dx), (wy, dy) = cubic_taps((x - column)[..., None]), cubic_taps((y - row)[..., None])
    first = row.astype(jnp.int32) * row_length + column.astype(jnp.int32) * channels
    flat = spline.reshape(-1)
    # Taps and channels of a row lie side by side: three times as fast as one gather for each.
    slices = lax.GatherDimensionNumbers(
        offset_dims=(2,), collapsed_slice_dims=(), start_index_map=(0,)
    )
    value = slope_x = slope_y = jnp.zeros((height, width, channels), spline.dtype)
    for j in range(4):
        taps = lax.gather(
            flat,
            (first + j * row_length)[..., None],
            slices,
            (4 * channels,),
            mode="promise_in_bounds",
        ).reshape(height, width, 4, channels)
        line = sum((wx[i] * taps[:, :, i] for i in range(1, 4)), wx[0] * taps[:, :, 0])
        line_x = sum((dx[i] * taps[:, :, i] for i in range(1, 4)), dx[0] * taps[:, :, 0])
        value, slope_x = value + wy[j] * line, slope_x + wy[j] * line_x
        slope_y = slope_y + dy[j] * line
    both = jnp.moveaxis(jnp.concatenate([value, slope_x, slope_y], axis=-1), -1, 0)
    return both[:channels], both[channels : 2 * channels], both[2 * channels :]
