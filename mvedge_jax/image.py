"""Image operations: sums, blurs, gradients, pixels of points, connected components."""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Shaped

from mvedge_jax._cpu import convolution as convolution
from mvedge_jax._linear_map import linear_map
from mvedge_jax._params import accepts_numpy
from mvedge_jax._root import safe_sqrt


@accepts_numpy
def window_sum(image: Array, radius: int, axis: int, *, border: str = "edge") -> Array:
    """Sum over `2 radius + 1` neighbors along an axis, by sums of doubling width.

    Args:
        image: any shape.
        radius: px to either side.
        axis: axis of the sum.
        border: values beyond the border: `"edge"` repeats it, `"constant"` is 0.

    Returns:
        The sums, of the shape of `image`. Differentiable.
    """
    axis = axis % image.ndim
    margin = [(0, 0)] * image.ndim
    margin[axis] = (radius, radius)

    whole, spread = partial(_whole_windows, radius, axis), partial(_spread_windows, radius, axis)
    return linear_map(whole, spread, None, jnp.pad(image, margin, mode=border))


def _spread_windows(radius: int, axis: int, _: None, sums: Array) -> Array:
    """The transpose of `_whole_windows`."""
    # JAX would turn slices into pads, which XLA on CPU does not vectorize.
    around = [(0, 0)] * sums.ndim
    around[axis] = (2 * radius, 2 * radius)
    return _whole_windows(radius, axis, None, jnp.pad(sums, around))


def _whole_windows(radius: int, axis: int, _: None, image: Array) -> Array:
    """Sums over the windows that lie within an image."""
    # By hand: XLA on CPU vectorizes sums of slices, but no window reduction.
    width = 2 * radius + 1
    size = image.shape[axis] - 2 * radius
    # The width is odd, so that the sum starts with single samples.
    part, total, offset, span = image, lax.slice_in_dim(image, 0, size, axis=axis), 1, 1
    while 2 * span <= width:
        length = part.shape[axis]
        part = lax.slice_in_dim(part, 0, length - span, axis=axis) + lax.slice_in_dim(
            part, span, length, axis=axis
        )
        span *= 2
        if width & span:
            total = total + lax.slice_in_dim(part, offset, offset + size, axis=axis)
            offset += span
    return total


@accepts_numpy
def box_mean(image: Float[Array, "*c y x"], radius: int) -> Float[Array, "*c y x"]:
    """Mean over a square of `2 radius + 1` px a side, borders repeated.

    Args:
        image: one image or several, `[..., y, x]`.
        radius: px to either side.

    Returns:
        The means, of the shape of `image`. Differentiable.
    """
    area = (2 * radius + 1) ** 2
    return window_sum(window_sum(image, radius, -2), radius, -1) / area


@accepts_numpy
def gaussian_taps(sigma: Float[Array, ""], radius: int) -> Float[Array, " k"]:
    """Taps of a Gaussian, which sum to 1.

    Args:
        sigma: standard deviation, px; 0 gives the identity.
        radius: where the Gaussian is cut, px.

    Returns:
        `2 radius + 1` taps. Differentiable from a `sigma` of .1 px.
    """
    offsets = jnp.arange(-radius, radius + 1, dtype=sigma.dtype)
    # A Gaussian much narrower than a pixel has no weight at its neighbors.
    safe = jnp.maximum(sigma, 0.1)
    taps = jnp.exp(-0.5 * (offsets / safe) ** 2)
    return taps / jnp.sum(taps)


@accepts_numpy
def convolved(image: Array, taps: Float[Array, " k"], axis: int) -> Array:
    """Image filtered along an axis, borders repeated.

    Args:
        image: any shape.
        taps: an odd number of them, as a correlation has them.
        axis: along which to filter.

    Returns:
        The filtered image, of the shape of `image`. Differentiable in both.
    """
    radius = taps.shape[0] // 2
    axis = axis % image.ndim
    margin = [(0, 0)] * image.ndim
    margin[axis] = (radius, radius)
    padded = jnp.pad(image, margin, mode="edge")
    size = image.shape[axis]
    parts = [
        taps[i] * lax.slice_in_dim(padded, i, i + size, axis=axis) for i in range(taps.shape[0])
    ]
    return sum(parts[1:], parts[0])


@accepts_numpy
def gaussian(
    image: Float[Array, "*c y x"], sigma: Float[Array, ""], radius: int
) -> Float[Array, "*c y x"]:
    """Image blurred by a Gaussian, borders repeated.

    Args:
        image: one image or several, `[..., y, x]`.
        sigma: standard deviation, px; 0 gives the identity.
        radius: where the Gaussian is cut, px.

    Returns:
        The blurred image, of the shape of `image`. Differentiable in both, in `sigma` from .1 px.
    """
    taps = gaussian_taps(sigma, radius)
    return convolved(convolved(image, taps, -2), taps, -1)


@accepts_numpy
def highest(image: Float[Array, "y x"], radius: int) -> Float[Array, "y x"]:
    """Largest value within a square of `2 radius + 1` px a side.

    Args:
        image: `[y, x]`.
        radius: px to either side.

    Returns:
        The maxima, `[y, x]`. Differentiable, at the place chosen.
    """
    for axis in (0, 1):
        reach = 0
        while reach < radius:
            step = min(reach + 1, radius - reach) if reach else 1
            margin = [(0, 0), (0, 0)]
            margin[axis] = (step, step)
            padded = jnp.pad(image, margin, mode="edge")
            size = image.shape[axis]
            below = lax.slice_in_dim(padded, 0, size, axis=axis)
            above = lax.slice_in_dim(padded, 2 * step, 2 * step + size, axis=axis)
            image = jnp.maximum(image, jnp.maximum(below, above))
            reach += step
    return image


def highest_beside(
    values: Float[Array, "y x"], companion: Shaped[Array, "y x"]
) -> tuple[Float[Array, "y x"], Shaped[Array, "y x"]]:
    """The largest value of 3x3 pixels, and what another image holds where it is.

    Args:
        values: `[y, x]`.
        companion: the other image.

    Returns:
        Both per pixel. Differentiable, at the places chosen.
    """
    for axis in (0, 1):
        margin = [(0, 0), (0, 0)]
        margin[axis] = (1, 1)
        padded = jnp.pad(values, margin, constant_values=-jnp.inf), jnp.pad(companion, margin)
        size = values.shape[axis]
        for offset in (0, 2):
            value, other = (
                lax.slice_in_dim(image, offset, offset + size, axis=axis) for image in padded
            )
            wins = value > values
            values, companion = jnp.where(wins, value, values), jnp.where(wins, other, companion)
    return values, companion


def gradient_square(image: Float[Array, "y x"]) -> Float[Array, "y x"]:
    """Squared size of the gradient of an image, by central differences; the border is repeated.

    Args:
        image: any values, `[y, x]`.

    Returns:
        Squared values per px, `[y, x]`. Differentiable.
    """
    wide = jnp.pad(image, ((0, 0), (1, 1)), mode="edge")
    tall = jnp.pad(image, ((1, 1), (0, 0)), mode="edge")
    return 0.25 * ((wide[:, 2:] - wide[:, :-2]) ** 2 + (tall[2:] - tall[:-2]) ** 2)


def gradient_magnitude(image: Float[Array, "y x"]) -> Float[Array, "y x"]:
    """Size of the gradient of an image: the root of `gradient_square`, also where it is flat.

    Args:
        image: any values, `[y, x]`.

    Returns:
        Values per px, `[y, x]`. Differentiable.
    """
    return safe_sqrt(gradient_square(image))


@accepts_numpy
def unit_gradient(image: Float[Array, "y x"]) -> Float[Array, "y x 2"]:
    """Unit direction of the smoothed gradient.

    Args:
        image: `[y, x]`.

    Returns:
        `(x, y)` per pixel, 0 where the image is flat. Differentiable.
    """
    blur = jnp.asarray([1.0, 4.0, 6.0, 4.0, 1.0], image.dtype) / 16
    slope = jnp.asarray([-1.0, -2.0, 0.0, 2.0, 1.0], image.dtype) / 8
    across = convolved(convolved(image, blur, 0), slope, 1)
    down = convolved(convolved(image, blur, 1), slope, 0)
    gradient = jnp.stack([across, down], -1)
    square = (gradient**2).sum(-1, keepdims=True)
    safe = jnp.where(square > 1e-12, square, 1)
    return jnp.where(square > 1e-12, gradient / jnp.sqrt(safe), 0)


class Pixels(NamedTuple):
    """The nearest pixels of points, within an image.

    Attributes:
        row: y of each.
        column: x of each.
        inside: which points lie in the image; the pixels of the others are on its border.
    """

    row: Int[Array, " n"]
    column: Int[Array, " n"]
    inside: Bool[Array, " n"]

    def places(self, width: int) -> Int[Array, " n"]:
        """Index of each pixel in an image of that width, flattened by rows."""
        return self.row * width + self.column


@accepts_numpy
def nearest_pixels(xy: Float[Array, "n 2"], shape: tuple[int, int]) -> Pixels:
    """The pixels that points are on.

    Args:
        xy: positions `(x, y)`, px.
        shape: rows and columns of the image.

    Returns:
        A pixel per point; no gradient passes through it.
    """
    height, width = shape
    column, row = jnp.round(lax.stop_gradient(xy)).astype(jnp.int32).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return Pixels(jnp.clip(row, 0, height - 1), jnp.clip(column, 0, width - 1), inside)


def components(right: Bool[Array, "*s y x"], down: Bool[Array, "*s y x"]) -> Int[Array, "*s y x"]:
    """Connected pieces of images with links between neighboring pixels.

    Args:
        right: whether a pixel is linked to the next one in its row; the last column is not read.
        down: whether it is linked to the one below; the last row is not read.

    Returns:
        Of every pixel, the least flat index within its image of all pixels it is connected to.

    Example:
        >>> import jax.numpy as jnp
        >>> row = jnp.array([[True, False, True, True]])
        >>> components(row, row).tolist()
        [[0, 0, 2, 2]]
    """
    shape, (height, width) = right.shape, right.shape[-2:]
    # Scans run over the first axis: one copy with rows in front, one with columns.
    below = jnp.moveaxis(down.reshape(-1, height, width), 1, 0)[:-1]
    beside = jnp.moveaxis(right.reshape(-1, height, width), 2, 0)[:-1]
    own = jnp.arange(height * width, dtype=jnp.int32).reshape(height, width)
    start = jnp.broadcast_to(own, (right.size // own.size, height, width))

    def swept(least: Array, links: Array) -> Array:
        """Least values handed on along the first axis, there and back."""
        for reverse in (False, True):
            first, rest = (least[-1], least[:-1]) if reverse else (least[0], least[1:])

            def hand(carry: Array, item: tuple[Array, Array]) -> tuple[Array, Array]:
                here, linked = item
                here = jnp.where(linked, jnp.minimum(here, carry), here)
                return here, here

            _, rest = lax.scan(hand, first, (rest, links), reverse=reverse)
            parts = [rest, first[None]] if reverse else [first[None], rest]
            least = jnp.concatenate(parts)
        return least

    def spread(state: tuple[Array, Array]) -> tuple[Array, Array]:
        least, _ = state
        down = swept(jnp.moveaxis(least, 1, 0), below)
        both = swept(jnp.moveaxis(jnp.moveaxis(down, 0, 1), 2, 0), beside)
        both = jnp.moveaxis(both, 0, 2)
        return both, jnp.any(both != least)

    result, _ = lax.while_loop(lambda state: state[1], spread, (start, jnp.asarray(True)))
    return result.reshape(shape)
