"""Gains and vignettes: brightness of the views relative to one of them."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._product import FULL, product
from mvedge_jax.image import gaussian_taps

from ..views._parallax import Parallax, inside
from ._brightness import Brightness
from ._vignette import SIZE, basis_at, basis_of_blocks, falloff, falloff_at, radial, vignettes


class Ratios(NamedTuple):
    """Brightness of views relative to one of them.

    Attributes:
        gain: of each view.
        variance: error variance of the gains.
        vignette: see `Exposure.vignette`; 0 unless fitted.
    """

    gain: Float[Array, " s"]
    variance: Float[Array, " s"]
    vignette: Float[Array, "s 4 4"]


def brightening(center: Float[Array, "y x c"], params: Brightness) -> Float[Array, ""]:
    """Factor that brings the bright parts of an image to a fixed level."""
    bright = jnp.sort(center[::4, ::4].reshape(-1))
    level = bright[int(0.99 * (bright.shape[0] - 1))]
    bright, most = params.bright, params.brightest
    return jnp.clip(bright / jnp.maximum(level, bright / most), 1, most)


def _block(shape: tuple[int, ...]) -> int:
    """Side of the blocks that are averaged, px."""
    return min(8, max(1, min(shape) // 16))


def block_means(images: Float[Array, "s y x c"]) -> Float[Array, "s h w"]:
    """Mean brightness of square blocks of every image."""
    count, height, width, channels = images.shape
    block = _block((height, width))
    rows, columns = height // block, width // block
    whole = images[:, : rows * block, : columns * block]
    return whole.reshape(count, rows, block, columns, block * channels).mean((2, 4))


def _flat(values: Float[Array, "s h w"]) -> Float[Array, "s n"]:
    return values.reshape(values.shape[0], -1)


def rough_ratios(
    means: Float[Array, "s h w"],
    there: Bool[Array, " s"],
    own: int,
    shape: tuple[int, ...],
    params: Brightness,
    *,
    uneven: bool = True,
) -> Ratios:
    """Gains and, if `uneven`, vignettes of views without known disparities. Differentiable.

    Args:
        means: see `block_means`.
        there: which views to read.
        own: index of the reference view.
        shape: rows and columns of the views.
        params: see `Brightness`.
        uneven: fit vignettes.
    """
    if not uneven:
        return _ratios(_flat(means), there, own, params)
    block, (rows, columns) = _block(shape), means.shape[1:]
    cell = max(1, min(rows, columns) // 16)
    down, across = rows // cell, columns // cell
    whole = means[:, : down * cell, : across * cell]
    cells = _flat(whole.reshape(-1, down, cell, across, cell).mean((2, 4)))
    of_own = cells[own][None]
    known = _shown(of_own, 0.95) & (cells > 0) & (cells < 0.95) & there[:, None]
    logs = _logs(cells, of_own, known)
    basis = jnp.asarray(basis_of_blocks(shape, block * cell), means.dtype)[None]
    basis = jnp.broadcast_to(basis, (means.shape[0], *basis.shape[1:]))
    known = known.astype(logs.dtype)
    least = params.vignette_rough * _narrow(shape, params)
    vignette = vignettes(logs, known, basis, params, least=least, shape=shape)
    even = means * falloff(vignette, shape, block=block)
    return _ratios(_flat(even), there, own, params)._replace(vignette=vignette)


def _narrow(shape: tuple[int, ...], params: Brightness) -> Array:
    """Factor of the allowed variation in small frames, of which parallax moves a larger part."""
    return jnp.maximum(params.vignette_side / min(shape), 1)


def _logs(values: Array, own: Array, known: Bool[Array, "*n"]) -> Float[Array, "*n"]:
    """Log ratios, 0 where they are not known."""
    return jnp.log(jnp.where(known, values, 1) / jnp.where(known, own, 1))


def _shown(values: Float[Array, "*n"], most: float) -> Bool[Array, "*n"]:
    """Whether values are bright enough for a ratio, and not clipped."""
    return (values > 0.1 * jnp.median(values)) & (values > 0) & (values < most)


def _ratios(
    values: Float[Array, "s n"], there: Bool[Array, " s"], own: int, params: Brightness
) -> Ratios:
    """Median ratio of every view to one of them, block by block."""
    of_own = values[own][None]
    shown = _shown(of_own, 0.95)
    ratio = jnp.where(values > 0, values, of_own) / jnp.where(shown, of_own, 1)
    known = shown & there[:, None]
    gain = _median(ratio, known)
    # Variance of the median of this many values.
    scatter = 1.25 * 1.48 * _median(jnp.abs(ratio - gain[:, None]), known)
    count = jnp.sum(known, axis=1).astype(gain.dtype)
    variance = params.alike * scatter**2 / jnp.maximum(count, 1)
    even = jnp.zeros((values.shape[0], SIZE, SIZE), values.dtype)
    return Ratios(gain, jnp.where(count > 0, variance, 0), even)


def shrunk_gains(ratios: Ratios, params: Brightness) -> Float[Array, " s"]:
    """Gains, shrunk to 1 where they hardly differ or are inaccurate."""
    logs, error = jnp.log(ratios.gain), jnp.mean(ratios.variance)
    excess = jnp.maximum(jnp.mean(logs**2) - 2 * error, 0)
    return jnp.exp(excess / (excess + params.gain_prior**2) * logs)


def _median(values: Float[Array, "s n"], known: Array) -> Float[Array, " s"]:
    """Median of the known values of every row; 1 where none is known."""
    ordered = jnp.sort(jnp.where(known, values, jnp.inf), axis=1)
    count = jnp.sum(known, axis=1)
    middle = jnp.maximum(count - 1, 0) // 2
    median = jnp.take_along_axis(ordered, middle[:, None], axis=1)[:, 0]
    return jnp.where(count > 0, median, 1)


def ratios_along(
    views: Float[Array, "s y x c"],
    parallax: Parallax,
    available: Bool[Array, " s"],
    center: int,
    disparity: Float[Array, "y x"],
    params: Brightness,
    *,
    uneven: Bool[Array, ""] | bool,
) -> Ratios:
    """Gains of views along the disparity map of one of them, and vignettes if they are `uneven`."""
    shape = disparity.shape[0], disparity.shape[1]
    stride = min(16, max(1, min(shape) // 24))

    def sampled(item: tuple[Array, Parallax, Array]) -> tuple[Array, ...]:
        view, own, there = item
        x, y = (position[::stride, ::stride] for position in own.positions(disparity))
        known = inside(x, y, shape) & there
        return _blurred_at(view, x, y, params), known, basis_at(y, x, shape)

    seen, known, basis = lax.map(sampled, (views, parallax, available))
    own, count = seen[center], seen.shape[0]
    known = known[..., None] & _shown(own, 0.97)[None] & (seen < 0.97)
    usable = jnp.all(known & (seen > 0), axis=-1)
    logs = _logs(jnp.mean(seen, axis=-1), jnp.mean(own, axis=-1)[None], usable)
    of_view = basis.reshape(count, -1, SIZE**2)
    flat = jnp.asarray(radial(shape).ravel(), seen.dtype)
    vignette = vignettes(
        _flat(logs), _flat(usable.astype(logs.dtype)), of_view, params,
        least=params.vignette_prior * _narrow(shape, params),
        moved=product(of_view - of_view[center][None], flat), shape=shape,
    )  # fmt: skip
    vignette = jnp.where(uneven, vignette, 0)
    seen = seen * falloff_at(vignette, of_view).reshape(*usable.shape, 1)
    own = seen[center]
    seen, known = seen.reshape(count, -1), known.reshape(count, -1)
    own = jnp.broadcast_to(own.reshape(1, -1), seen.shape)
    gain = _median(seen / jnp.where(known, own, 1), known)
    variance = jnp.zeros_like(gain)
    for _ in range(3):
        residual = jnp.abs(seen - gain[:, None] * own)
        spread = 1.48 * _median(residual, known) + 1e-4
        weight = known.astype(seen.dtype) / (1 + (residual / (2 * spread[:, None])) ** 2) ** 2
        power = jnp.sum(weight * own * own, axis=1)
        fitted = jnp.sum(weight * own * seen, axis=1) / jnp.where(power > 0, power, 1)
        gain = jnp.where(power > 0, fitted, 1)
        variance = jnp.where(power > 0, spread**2 / jnp.where(power > 0, power, 1), 0)
    return Ratios(gain, variance, vignette)


def _blurred_at(
    image: Float[Array, "y x c"], x: Array, y: Array, params: Brightness
) -> Float[Array, "*p c"]:
    """Gaussian means of an image around positions, borders repeated."""
    height, width, channels = image.shape
    reach = params.blur_reach
    size = 2 * reach + 2
    margin = (reach, reach + 1)
    padded = jnp.pad(image, (margin, margin, (0, 0)), mode="edge")
    x, y = jnp.clip(x, 0, width - 1), jnp.clip(y, 0, height - 1)
    column, row = jnp.floor(x), jnp.floor(y)

    gaussian = gaussian_taps(params.blur, reach)
    before, after = jnp.pad(gaussian, (0, 1)), jnp.pad(gaussian, (1, 0))

    def taps(part: Array) -> Array:
        # Between pixels, blurred values are interpolated linearly.
        return (1 - part)[..., None] * before[None, None] + part[..., None] * after[None, None]

    windows = lax.gather(
        padded,
        jnp.stack([row, column], axis=-1).astype(jnp.int32),
        lax.GatherDimensionNumbers(
            offset_dims=(2, 3, 4), collapsed_slice_dims=(), start_index_map=(0, 1)
        ),
        (size, size, channels),
        mode="promise_in_bounds",
    )
    down, across = taps(y - row), taps(x - column)
    return jnp.einsum("yxi,yxj,yxijc->yxc", down, across, windows, precision=FULL)
