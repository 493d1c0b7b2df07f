"""Normal equations over all views of a light field, or over posed photographs."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._cpu import plane_sum
from mvedge_jax._params import cast
from mvedge_jax.image import box_mean
from mvedge_jax.interpolation import cubic_taps, spline_coefficients

from ..views import ViewSet
from ..views._parallax import GridShift, Parallax, shown_at
from ._crosshair import NormalEquations
from ._measuring import AdaptedMeasurement

# Margin of the four taps of a cubic spline beyond the pixel before a position.
_BEFORE, _AFTER = 1, 2


class _Totals(NamedTuple):
    """Sums over the views: weights, steps, their products, colors, their products with steps."""

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


class ViewSplines(NamedTuple):
    """Spline coefficients of the views of a `ViewSet`.

    Attributes:
        splines: coefficients of cubic splines, `[s, y, x]`; every row is longer than the images'
            by 3 px and has its channels side by side.
        parallax: where each view shows the pixels of the first one.
        available: which views are read, `[s]`.
        shown: 1 where they show the scene, 0 where they are transparent; None for everywhere.
    """

    splines: Float[Array, "s h w"]
    parallax: Parallax
    available: Bool[Array, " s"]
    shown: Float[Array, "s y x"] | None = None

    @staticmethod
    def of(views: ViewSet) -> "ViewSplines":
        """Coefficients of views after exposure and gains. Differentiable."""

        def one(view: Array) -> Array:
            both = spline_coefficients(spline_coefficients(view, axis=-1), axis=-2)
            last = jnp.moveaxis(both, 0, -1)
            margin = (_BEFORE, _AFTER)
            padded = jnp.pad(last, (margin, margin, (0, 0)), mode="edge")
            return padded.reshape(padded.shape[0], -1)

        return ViewSplines(lax.map(one, views.planes), *views[1:])

    @jax.jit
    def accumulate(
        self, disparity: Float[Array, "y x"], params: AdaptedMeasurement
    ) -> NormalEquations:
        """See `CrosshairSplines.accumulate`.

        Steps of photographs differ from pixel to pixel: a step is the movement of the pixel itself
        that is equivalent to a change of disparity by 1.
        """
        params, shown = cast(params, disparity.dtype), self.shown
        still = GridShift(jnp.zeros(2, disparity.dtype))
        reference, *_ = _sample(self.splines[0], *still.positions(disparity))

        @jax.checkpoint
        def read(total: tuple[Array, ...], view: tuple["ViewSplines", Array]):
            one, itself = view
            seen = one.parallax.seen(disparity, params.radius, slant=params.slant) & one.available
            x, y = one.parallax.positions(disparity)
            if shown is not None and one.shown is not None:
                # Pixels that are transparent in either view are left out; the reference shows
                # itself.
                seen = seen & (itself | shown_at(one.shown, x, y) & (shown[0] > 0))
            weight = seen.astype(disparity.dtype)
            value, *slopes = _sample(one.splines, x, y)
            slope_x, slope_y = one.parallax.pulled(disparity, (slopes[0], slopes[1]))
            relative = value - reference
            w = weight[None]
            terms = (weight, w * relative, w * relative**2, w * slope_x, w * slope_y)
            return tuple(t + new for t, new in zip(total, terms, strict=True)), (weight, relative)

        zero, zeros = jnp.zeros_like(disparity), jnp.zeros_like(reference)
        itself = jnp.arange(self.splines.shape[0]) == 0
        (count, color, square, gx, gy), seen = lax.scan(read, (zero, *[zeros] * 4), (self, itself))
        mean, gx, gy = (part / count[None] for part in (color, gx, gy))
        spread = plane_sum(square / count[None] - mean**2)
        floor = reference.shape[0] * params.noise**2
        scale = params.outlier * jnp.maximum(box_mean(spread, 1), floor)

        @jax.checkpoint
        def add(total: _Totals, view: tuple[Array, Array, Parallax]) -> tuple[_Totals, None]:
            weight, relative, parallax = view
            relative = relative - mean
            weight = weight / (1 + box_mean(plane_sum(relative**2), 1) / scale)
            x, y = parallax.steps(disparity)
            w = weight[None]
            new = _Totals(
                weight, weight * x, weight * y, weight * x * x, weight * x * y, weight * y * y,
                w * relative, (weight * x)[None] * relative, (weight * y)[None] * relative,
                w * relative**2,
            )  # fmt: skip
            return jax.tree.map(jnp.add, total, new), None

        start = _Totals(*[zero] * 6, *[zeros] * 4)
        total, _ = lax.scan(add, start, (*seen, self.parallax))
        return _equations(total, gx, gy, jnp.sum(self.available.astype(disparity.dtype)))


def _equations(total: _Totals, gx: Array, gy: Array, views: Array) -> NormalEquations:
    n, x, y, r = total.n, total.x, total.y, total.r
    xx, xy, yy = total.xx - x * x / n, total.xy - x * y / n, total.yy - y * y / n
    rx, ry = total.rx - (x / n)[None] * r, total.ry - (y / n)[None] * r
    along_x, along_y = xx[None] * gx + xy[None] * gy, xy[None] * gx + yy[None] * gy
    return NormalEquations(
        right=-plane_sum(gx * rx + gy * ry),
        information=plane_sum(gx * along_x + gy * along_y),
        power=plane_sum(total.rr - r * r / n[None]),
        freedom=n - 1,
        views=views,
        spread=(xx, yy),
        cross=xy,
        slope=(tuple(along_x), tuple(along_y)),
        trend=(tuple(rx), tuple(ry)),
    )


def _sample(
    spline: Float[Array, "h w"], x: Float[Array, "y x"], y: Float[Array, "y x"]
) -> tuple[Float[Array, "c y x"], Float[Array, "c y x"], Float[Array, "c y x"]]:
    """A view at the positions of the pixels, and its derivatives along x and y."""
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
