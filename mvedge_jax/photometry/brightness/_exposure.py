"""Brightness of the views: exposure of the whole light field, gain of each view."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._crosshair import Arm
from mvedge_jax._params import cast
from mvedge_jax._product import FULL
from mvedge_jax.image import gaussian_taps
from mvedge_jax.lightfield import LightField

from .._places import Projection, Shift
from ._brightness import Brightness


class _Ratio(NamedTuple):
    """Gains of the views of an arm and the variances of their errors."""

    gain: Float[Array, " s"]
    variance: Float[Array, " s"]


class Exposure(NamedTuple):
    """What the views are multiplied by before their colours are compared.

    Attributes:
        scale: factor for all views, which makes dark ones as bright as floors and weights expect,
            from 1 to `Brightness.brightest`.
        gain: brightness of each view relative to the centre view, `[v, u]`, by which it is divided;
            1 for views that were not asked for.
    """

    scale: Float[Array, ""]
    gain: Float[Array, "v u"]

    def everywhere(
        self,
        light_field: LightField,
        disparity: Float[Array, "y x"],
        *,
        params: Brightness | None = None,
    ) -> "Exposure":
        """The same with the gains of all views, measured along a map of the centre view.

        Args:
            light_field: the views as they came.
            disparity: px per view step, `[y, x]`.
            params: see `Brightness`; None for the defaults.

        Returns:
            Gains to about 0.2 %. Differentiable in the views and the map.
        """
        return exposure_along(light_field, self.scale, disparity, every=True, params=params)


def expose(light_field: LightField, exposure: Exposure) -> LightField:
    """Takes exposure and gains out of the views.

    Args:
        light_field: the views as they came.
        exposure: what to take out.

    Returns:
        The same with views whose colours compare; bright pixels may exceed 1. Differentiable.

    Example:
        >>> import jax.numpy as jnp
        >>> dark = LightField(jnp.full((3, 3, 8, 8, 3), 0.1))
        >>> exposed = expose(dark, Exposure(jnp.asarray(5.0), jnp.ones((3, 3))))
        >>> bool(jnp.allclose(exposed.views, 0.5))
        True
    """
    factor = (exposure.scale / exposure.gain)[:, :, None, None, None]
    return eqx.tree_at(lambda field: field.views, light_field, light_field.views * factor)


def exposed_arms(arms: tuple[Arm, Arm], exposure: Exposure) -> tuple[Arm, Arm]:
    """`expose` for the crosshair alone.

    Args:
        arms: horizontal and vertical, as they came.
        exposure: what to take out.

    Returns:
        The same, whose colours compare. Differentiable.
    """
    horizontal, vertical = arms
    gains = exposure.gain[vertical.centre], exposure.gain[:, horizontal.centre]
    across, down = (
        arm._replace(planes=arm.planes * (exposure.scale / gain)[:, None, None, None])
        for arm, gain in zip(arms, gains, strict=True)
    )
    return across, down


def rough_exposure(light_field: LightField, *, params: Brightness | None = None) -> Exposure:
    """Exposure and gains without knowing any disparity.

    The gain is the median ratio of the blurred views: what parallax adds to it goes both ways.

    Args:
        light_field: the crosshair of views is read.
        params: see `Brightness`; None for the defaults.

    Returns:
        Gains to about 1 %. Differentiable in the views.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> image = jax.random.uniform(jax.random.key(0), (64, 64, 3), minval=0.2, maxval=0.6)
        >>> gain = jnp.asarray([[1.0, 1.1, 1.0], [0.9, 1.0, 1.0], [1.0, 1.0, 1.2]])
        >>> views = gain[:, :, None, None, None] * image[None, None]
        >>> found = rough_exposure(LightField(views)).gain
        >>> [round(float(found[v, u]), 2) for v, u in ((0, 1), (1, 0))]
        [1.1, 0.9]
    """
    views = light_field.views
    params = cast(Brightness() if params is None else params, views.dtype)
    scale = _brightening(light_field.centre_view, params)
    vc, uc = light_field.centre
    across = _ratios(light_field.horizontal_arm, light_field.available[vc], uc, params)
    down = _ratios(light_field.vertical_arm, light_field.available[:, uc], vc, params)
    return Exposure(scale, _gains(across, down, views, params))


def rough_gains(
    images: Float[Array, "s y x c"], available: Bool[Array, " s"], params: Brightness
) -> tuple[Float[Array, ""], Float[Array, " s"]]:
    """`rough_exposure` for photographs, the first of which is the reference.

    Args:
        images: sRGB, as they came.
        available: which of them are to be read.
        params: see `Brightness`.

    Returns:
        What all views are multiplied by, see `Exposure.scale`, and the gain of each. Differentiable
        in the images.
    """
    params = cast(params, images.dtype)
    return _brightening(images[0], params), _earned(_ratios(images, available, 0, params), params)


def gains_along(
    images: Float[Array, "s y x c"],
    places: Projection,
    available: Bool[Array, " s"],
    disparity: Float[Array, "y x"],
    params: Brightness,
) -> Float[Array, " s"]:
    """`exposure_along` for photographs, the first of which is the reference.

    Args:
        images: sRGB, as they came.
        places: where each shows the pixels of the first one.
        available: which of them are to be read.
        disparity: of the first one, `[y, x]`.
        params: see `Brightness`.

    Returns:
        The gain of each. Differentiable.
    """
    params = cast(params, images.dtype)
    return _earned(_regressed(images, places, available, 0, disparity, params), params)


def _brightening(centre: Float[Array, "y x c"], params: Brightness) -> Float[Array, ""]:
    """What brings the bright parts of an image to a fixed level."""
    bright = jnp.sort(centre[::4, ::4].reshape(-1))
    level = bright[int(0.99 * (bright.shape[0] - 1))]
    bright, most = params.bright, params.brightest
    return jnp.clip(bright / jnp.maximum(level, bright / most), 1, most)


def _ratios(
    images: Float[Array, "s y x c"], there: Bool[Array, " s"], own: int, params: Brightness
) -> _Ratio:
    """Median ratio of every image to one of them, block by block."""
    block = min(8, max(1, min(images.shape[1:3]) // 16))
    rows, columns = images.shape[1] // block, images.shape[2] // block
    whole = images[:, : rows * block, : columns * block]
    shape = (images.shape[0], rows, block, columns, block * images.shape[3])
    values = whole.reshape(shape).mean((2, 4)).reshape(images.shape[0], -1)
    of_own = values[own][None]
    shown = (of_own > 0.1 * jnp.median(of_own)) & (of_own < 0.95) & (of_own > 0)
    ratio = jnp.where(values > 0, values, of_own) / jnp.where(shown, of_own, 1)
    known = shown & there[:, None]
    gain = _median(ratio, known)
    # Of the median of so many values.
    scatter = 1.25 * 1.48 * _median(jnp.abs(ratio - gain[:, None]), known)
    count = jnp.sum(known, axis=1).astype(gain.dtype)
    variance = params.alike * scatter**2 / jnp.maximum(count, 1)
    return _Ratio(gain, jnp.where(count > 0, variance, 0))


def exposure_along(
    light_field: LightField,
    scale: Float[Array, ""],
    disparity: Float[Array, "y x"],
    *,
    every: bool = False,
    params: Brightness | None = None,
) -> Exposure:
    """Gains by robust regression of every view on the centre one, along a disparity map.

    Of the blurred views, every sixteenth pixel either way takes part: blurring keeps noise
    from shrinking the gains, and what the map or an occlusion gets wrong is an outlier.

    Args:
        light_field: the views as they came.
        scale: see `Exposure`.
        disparity: px per view step, `[y, x]`.
        every: measure all views, not those of the crosshair alone.
        params: see `Brightness`; None for the defaults.

    Returns:
        Gains to about 0.2 %. Differentiable in the views and the map.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> image = jax.random.uniform(jax.random.key(0), (64, 64, 3), minval=0.2, maxval=0.6)
        >>> gain = jnp.asarray([[1.0, 1.1, 1.0], [0.9, 1.0, 1.0], [1.0, 1.0, 1.2]])
        >>> views = gain[:, :, None, None, None] * image[None, None]
        >>> found = exposure_along(LightField(views), jnp.ones(()), jnp.zeros((64, 64))).gain
        >>> [round(float(found[v, u]), 3) for v, u in ((0, 1), (1, 0))]
        [1.1, 0.9]
    """
    views, (rows, columns) = light_field.views, light_field.views.shape[:2]
    params = cast(Brightness() if params is None else params, views.dtype)
    own = light_field.centre
    places = [
        (v, u) for v in range(rows) for u in range(columns) if every or v == own[0] or u == own[1]
    ]
    v, u = (np.asarray(axis) for axis in zip(*places, strict=True))
    found = _regressed(
        views[v, u],
        Shift(light_field.steps[v, u].astype(views.dtype)),
        light_field.available[v, u],
        places.index(own),
        disparity,
        params,
    )
    gain = jnp.ones((rows, columns), views.dtype).at[v, u].set(_earned(found, params))
    return Exposure(scale, gain)


def _gains(across: _Ratio, down: _Ratio, views: Array, params: Brightness) -> Float[Array, "v u"]:
    """Gains of the crosshair on the grid of views."""
    both = _Ratio(*(jnp.concatenate(pair) for pair in zip(across, down, strict=True)))
    row, column = jnp.split(_earned(both, params), [across.gain.shape[0]])
    gain = jnp.ones(views.shape[:2], views.dtype)
    return gain.at[views.shape[0] // 2].set(row).at[:, views.shape[1] // 2].set(column)


def _earned(found: _Ratio, params: Brightness) -> Float[Array, " s"]:
    """Gains, drawn to 1 where they hardly differ or are badly known."""
    logs, error = jnp.log(found.gain), jnp.mean(found.variance)
    excess = jnp.maximum(jnp.mean(logs**2) - 2 * error, 0)
    return jnp.exp(excess / (excess + params.gain_prior**2) * logs)


def _median(values: Float[Array, "s n"], known: Array) -> Float[Array, " s"]:
    """Median of the known values of every row; 1 where none is known."""
    ordered = jnp.sort(jnp.where(known, values, jnp.inf), axis=1)
    count = jnp.sum(known, axis=1)
    place = jnp.maximum(count - 1, 0) // 2
    found = jnp.take_along_axis(ordered, place[:, None], axis=1)[:, 0]
    return jnp.where(count > 0, jnp.where(count > 0, found, 1), 1)


def _regressed(
    views: Float[Array, "s y x c"],
    places: Shift | Projection,
    available: Array,
    centre: int,
    disparity: Float[Array, "y x"],
    params: Brightness,
) -> _Ratio:
    """Gain of every view."""
    height, width = disparity.shape
    stride = min(16, max(1, min(height, width) // 24))

    def look(item: tuple[Array, Shift | Projection, Array]) -> tuple[Array, Array]:
        view, place, there = item
        x, y = (position[::stride, ::stride] for position in place.positions(disparity))
        inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        return _blurred_at(view, x, y, params), inside & there

    seen, known = lax.map(look, (views, places, available))
    own = seen[centre]
    shown = (own > 0.1 * jnp.median(own)) & (own > 0) & (own < 0.97)
    known = known[..., None] & shown[None] & (seen < 0.97)
    count = seen.shape[0]
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
    return _Ratio(gain, variance)


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
