"""Windows that follow an image: sums over neighbors, largest values, contrast."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._cpu import no_fuse, plane_sum
from mvedge_jax._linear_map import linear_map
from mvedge_jax._root import safe_sqrt
from mvedge_jax.image import highest


def weighted_sum(
    images: Float[Array, "n y x"],
    weights: Float[Array, "o y x"],
    *,
    spacing: int = 1,
    mode: str = "edge",
) -> Float[Array, "n y x"]:
    """Sums of planes `[n, y, x]` over a square window with separate weights at every pixel.

    `weights` holds one plane per offset, row by row, of pixels `spacing` px apart. Beyond the
    border, `mode` repeats it (`"edge"`) or is 0 (`"constant"`). Differentiable.
    """
    # Unrolled, this is one fused pass over the images, three times as fast on a CPU as a scan over
    # the offsets, as long as no other operation is fused into the loop.
    return no_fuse(partial(_summed, _Window(spacing, mode)), images, weights)


@dataclass(frozen=True)
class _Window:
    """Offsets of the pixels of a window."""

    spacing: int
    mode: str

    def padded(self, images: Array, count: int) -> Array:
        margin = (self.size(count) - 1) * self.spacing // 2
        return jnp.pad(images, ((0, 0), (margin, margin), (margin, margin)), mode=self.mode)

    def start(self, offset: Array | int, count: int) -> tuple[Any, ...]:
        size = self.size(count)
        # Slices need all indices of one type.
        return 0 * offset, offset // size * self.spacing, offset % size * self.spacing

    @staticmethod
    def size(count: int) -> int:
        return round(count**0.5)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _summed(window: _Window, images: Array, weights: Array) -> Array:
    count, (height, width) = weights.shape[0], images.shape[1:]
    padded = lax.optimization_barrier(window.padded(images, count))
    total = jnp.zeros_like(images)
    for o in range(count):
        _, y, x = window.start(o, count)
        total = total + weights[o][None] * padded[:, y : y + height, x : x + width]
    return total


@_summed.defjvp
def _summed_jvp(window: _Window, primals: Any, tangents: Any) -> tuple[Array, Array]:
    """Transposes are loops: unrolled, they would be most of any gradient's program."""
    (images, weights), (images_dot, weights_dot) = primals, tangents
    count, shape = weights.shape[0], images.shape

    def images_from(weights: Array, out: Array) -> Array:
        canvas, unpad = jax.vjp(lambda i: window.padded(i, count), jnp.zeros(shape, out.dtype))
        size, (height, width) = window.size(count), shape[1:]
        reach = (size - 1) * window.spacing
        sides = ((0, 0), (0, 0), (reach, reach))
        # Padded once, because a pad for every offset is not vectorized.
        rows = jnp.pad(weights, sides).reshape(size, size, height, width + 2 * reach)
        out = jnp.pad(out, sides)

        def add(canvas: Array, item: tuple[Array, Array]) -> tuple[Array, None]:
            # A row of the window at a time: one pass over the canvas for all of its offsets.
            weights, y = item
            start = window.start(y * size, count)
            sums = lax.dynamic_slice(canvas, start, (shape[0], height, width + reach))
            for x in range(size):
                first = reach - x * window.spacing
                part = slice(first, first + width + reach)
                sums = sums + weights[x, :, part][None] * out[..., part]
            return lax.dynamic_update_slice(canvas, sums, start), None

        canvas, _ = lax.scan(add, jnp.zeros_like(canvas), (rows, jnp.arange(size, dtype=jnp.int32)))
        return unpad(canvas)[0]

    def weights_from(images: Array, out: Array) -> Array:
        padded = window.padded(images, count)

        # One offset at a time: stacks of several are not vectorized.
        def products(offset: Array) -> Array:
            others = lax.dynamic_slice(padded, window.start(offset, count), shape)
            return plane_sum(others * out)

        return lax.map(products, jnp.arange(count, dtype=jnp.int32))

    along = linear_map(lambda w, i: _summed(window, i, w), images_from, weights, images_dot)
    turned = linear_map(partial(_summed, window), weights_from, images, weights_dot)
    return _summed(window, images, weights), along + turned


def color_weights(
    lab: Float[Array, "c y x"], scale: Float[Array, ""], *, reach: int, spacing: int = 1
) -> Float[Array, "o y x"]:
    """Weights of the neighbors by the similarity of their colors, which sum to 1. Differentiable.

    The window has `reach` pixels to either side, `spacing` px apart; `scale` is the difference of
    CIELAB color at which a weight is 1/e.
    """
    size, margin = 2 * reach + 1, reach * spacing
    padded = jnp.pad(lab, ((0, 0), (margin, margin), (margin, margin)), mode="edge")

    # Reverse mode stores the weights, not the half dozen intermediates of their size.
    @jax.checkpoint
    def weight(offset: Array) -> Array:
        start = (0, offset // size * spacing, offset % size * spacing)
        others = lax.dynamic_slice(padded, start, lab.shape)
        square = jnp.zeros_like(lab[0])
        for own, other in zip(lab, others, strict=True):
            square = square + (other - own) ** 2
        return jnp.exp(-safe_sqrt(square) / scale)

    # A loop, which compiles faster; unlike the sums, the weights are computed once.
    weights = lax.map(weight, jnp.arange(size * size))
    total, _ = lax.scan(lambda t, w: (t + w, None), jnp.zeros_like(lab[0]), weights)
    return weights / total[None]


def contrast(lab: Float[Array, "c y x"], *, radius: int) -> Float[Array, "y x"]:
    """Largest gradient within `radius` px along either axis, CIELAB per px.

    The image is blurred by about 1 px first, so that single noisy pixels are not outlines.
    Differentiable at the maximum chosen.
    """
    smooth = lab
    for _ in range(2):
        smooth = jnp.swapaxes(_smooth(smooth), 1, 2)
    wide = jnp.pad(smooth, ((0, 0), (1, 1), (1, 1)), mode="edge")
    across, down = wide[:, 1:-1, 2:] - wide[:, 1:-1, :-2], wide[:, 2:, 1:-1] - wide[:, :-2, 1:-1]
    return highest(safe_sqrt(plane_sum(0.25 * (across**2 + down**2))), radius)


def _smooth(image: Array) -> Array:
    """The binomial of five taps along the rows, whose variance is 1 px²."""
    width = image.shape[-1]
    padded = jnp.pad(image, ((0, 0), (0, 0), (2, 2)), mode="edge")
    taps = [padded[..., i : i + width] for i in range(5)]
    return (taps[0] + taps[4] + 4 * (taps[1] + taps[3]) + 6 * taps[2]) / 16
