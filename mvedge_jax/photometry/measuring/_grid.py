"""Reading all views around a map: those of a light field, or posed photographs."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import cast
from mvedge_jax.image import box_mean
from mvedge_jax.interpolation import cubic_taps, spline_coefficients

from .._places import Projection, Shift, shown_at
from ._look import Look
from ._measuring import Measuring

# What the four taps of a cubic spline reach beyond the pixel before a position.
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

    @property
    def places(self) -> Shift:
        """Where the views show a pixel."""
        return Shift(self.steps)

    @property
    def shown(self) -> None:
        """No view of a light field is transparent."""
        return None

    @property
    def reference(self) -> Array:
        """Index of the view whose pixels are looked for in the others."""
        return jnp.argmin(jnp.sum(jnp.abs(self.steps), axis=1))


class PosedGrid(NamedTuple):
    """Posed photographs of one size, made ready for being read between their pixels.

    Attributes:
        splines: see `Grid`.
        places: where each photograph shows the pixels of the first one.
        available: photographs that are to be read, `[s]`.
        shown: 1 where they show the scene, 0 where they are transparent; None for everywhere.
    """

    splines: Float[Array, "s h w"]
    places: Projection
    available: Bool[Array, " s"]
    shown: Float[Array, "s y x"] | None = None

    @property
    def reference(self) -> int:
        """Index of the view whose pixels are looked for in the others: the first one."""
        return 0


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
    return Grid(_splines(views), steps.astype(views.dtype), available)


def posed_grid(
    views: Float[Array, "s c y x"],
    places: Projection,
    available: Bool[Array, " s"],
    shown: Float[Array, "s y x"] | None = None,
) -> PosedGrid:
    """Makes posed photographs ready for `look_around`.

    Args:
        views: the reference view first, gains taken out.
        places: where each of them shows the pixels of the first one.
        available: those that are to be read.
        shown: 1 where they show the scene, 0 where they are transparent; None for everywhere.

    Returns:
        The grid. Differentiable.
    """
    # Rounding must not move the reference's own border out of its frame.
    own = Projection(
        places.homography.at[0].set(jnp.eye(3, dtype=views.dtype)), places.epipole.at[0].set(0)
    )
    return PosedGrid(_splines(views), own, available, shown)


def _splines(views: Float[Array, "s c y x"]) -> Float[Array, "s h w"]:
    def one(view: Array) -> Array:
        both = spline_coefficients(spline_coefficients(view, axis=-1), axis=-2)
        last = jnp.moveaxis(both, 0, -1)
        margin = (_BEFORE, _AFTER)
        padded = jnp.pad(last, (margin, margin, (0, 0)), mode="edge")
        return padded.reshape(padded.shape[0], -1)

    return lax.map(one, views)


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
    grid: Grid | PosedGrid, disparity: Float[Array, "y x"], params: Measuring, *, radius: int
) -> Look:
    """Reads colours and gradients of all views around a map: `look`, for a grid of views.

    Of photographs, steps are those of the pixel itself that would move it as a change of disparity
    does, and differ from pixel to pixel.

    Args:
        grid: of all views, see `grid_of` and `posed_grid`.
        disparity: px per view step, `[y, x]`.
        params: see `Measuring`.
        radius: how far occluders are looked for, px.

    Returns:
        What `labels` and `mismatch` read. Differentiable.
    """
    params, shown = cast(params, disparity.dtype), grid.shown
    still = Shift(jnp.zeros(2, disparity.dtype))
    reference, *_ = _sample(grid.splines[grid.reference], *still.positions(disparity))

    @jax.checkpoint
    def read(total: tuple[Array, ...], view: tuple[Array, Shift | Projection, Array, Any]):
        spline, place, there, both = view
        seen = place.seen(disparity, radius, slant=params.slant) & there
        if both is not None and shown is not None:
            # What is transparent in either is seen in neither; the reference sees all of itself.
            opaque, itself = both
            seen = seen & (itself | shown_at(opaque, *place.positions(disparity)) & (shown[0] > 0))
        weight = seen.astype(disparity.dtype)
        value, *slopes = _sample(spline, *place.positions(disparity))
        slope_x, slope_y = place.pulled(disparity, (slopes[0], slopes[1]))
        relative = value - reference
        w = weight[None]
        terms = (weight, w * relative, w * relative**2, w * slope_x, w * slope_y)
        return tuple(t + new for t, new in zip(total, terms, strict=True)), (weight, relative)

    zero, zeros = jnp.zeros_like(disparity), jnp.zeros_like(reference)
    both = None
    if shown is not None:
        both = shown, jnp.arange(shown.shape[0]) == grid.reference
    views = (grid.splines, grid.places, grid.available, both)
    (count, colour, square, gx, gy), seen = lax.scan(read, (zero, *[zeros] * 4), views)
    mean, gx, gy = (part / count[None] for part in (colour, gx, gy))
    spread = _total(square / count[None] - mean**2)
    floor = reference.shape[0] * params.noise**2
    scale = params.outlier * jnp.maximum(box_mean(spread, 1), floor)

    @jax.checkpoint
    def add(total: _Totals, view: tuple[Array, Array, Shift | Projection]) -> tuple[_Totals, None]:
        weight, relative, place = view
        relative = relative - mean
        weight = weight / (1 + box_mean(_total(relative**2), 1) / scale)
        x, y = place.steps(disparity)
        w = weight[None]
        new = _Totals(
            weight, weight * x, weight * y, weight * x * x, weight * x * y, weight * y * y,
            w * relative, (weight * x)[None] * relative, (weight * y)[None] * relative,
            w * relative**2,
        )  # fmt: skip
        return jax.tree.map(jnp.add, total, new), None

    start = _Totals(*[zero] * 6, *[zeros] * 4)
    total, _ = lax.scan(add, start, (*seen, grid.places))
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


def _total(planes: Float[Array, "c y x"]) -> Float[Array, "y x"]:
    """Sum over channels, by hand: XLA on CPU does not vectorise one over a leading axis."""
    total = planes[0]
    for plane in planes[1:]:
        total = total + plane
    return total


def _sample(
    spline: Float[Array, "h w"], x: Float[Array, "y x"], y: Float[Array, "y x"]
) -> tuple[Float[Array, "c y x"], Float[Array, "c y x"], Float[Array, "c y x"]]:
    """A view where it shows the pixels, and its derivatives along x and y."""
    height, width = x.shape
    row_length = spline.shape[1]
    channels = row_length // (width + _BEFORE + _AFTER)
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
