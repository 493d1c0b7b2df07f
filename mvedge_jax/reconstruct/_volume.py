"""Hypotheses: per pixel, the disparity whose views agree best, whatever hides some of them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._crosshair import Arm
from mvedge_jax._params import cast, number
from mvedge_jax.photometry import Noise, pooled

from ._paths import aggregate, length


class VolumeParams(eqx.Module):
    """Parameters of the hypotheses.

    Attributes:
        truncation: squared colour differences saturate at this many times the scene's noise, so
            that a view in which the pixel is hidden says nothing, instead of a lot.
        noise_floor: least noise assumed, standard deviation in units of sRGB.
        colour: neighbours whose CIELAB colour differs by much more than this do not take part.
        slant: price of a change by one hypothesis between neighbouring pixels; of 2, the cost of a
            pixel that no view confirms.
        jump: price of a larger change between pixels of the same colour.
        jump_colour: step of CIELAB colour that halves the price of a jump.
        pooling: how far costs are averaged along a surface where noise rules, px.
    """

    truncation: Float[Array, ""] = number(4.0)
    noise_floor: Float[Array, ""] = number(1.0 / 255)
    colour: Float[Array, ""] = number(4.0)
    slant: Float[Array, ""] = number(0.05)
    jump: Float[Array, ""] = number(0.8)
    jump_colour: Float[Array, ""] = number(4.0)
    pooling: Float[Array, ""] = number(20.0)


def hypotheses(
    horizontal: Arm,
    vertical: Arm,
    lab: Float[Array, "c y x"],
    disparities: Float[Array, " d"],
    params: VolumeParams,
    *,
    window: int,
    noise: Noise | None = None,
) -> Float[Array, "y x"]:
    r"""Per pixel, the disparity at which the views agree best.

    A pixel beside a nearer surface is hidden in the views of one side of each arm. Of each
    arm, therefore, only the half that agrees better counts:
    $\min(C_{left}, C_{right}) + \min(C_{above}, C_{below})$, each a mean of truncated
    squared colour differences to the centre view over a colour-weighted window.

    These costs are summed along paths through the image, so that pixels that the views say little
    about follow their surroundings; see `aggregate`. Noise makes jumps cheaper, softens the choice
    of the half, and has costs pooled along surfaces first.

    Args:
        horizontal: the horizontal arm, low-passed as the noise asks.
        vertical: the vertical arm, likewise, transposed.
        lab: the centre view in CIELAB, denoised, `[c, y, x]`.
        disparities: what to try, px per view step, increasing, evenly spaced.
        params: see `VolumeParams`.
        window: half the width of the window, px.
        noise: of the views before any low-pass; None for none.

    Returns:
        Disparity per pixel, between the hypotheses by a parabola. Differentiable in all but
        `disparities`' number, at the hypothesis chosen.
    """
    params = cast(params, lab.dtype)
    noise = Noise.of(jnp.zeros((), lab.dtype)) if noise is None else noise
    alpha = noise.alpha
    # Of views without noise, two thirds of what was measured: texture is in it.
    deviation = noise.deviation * (alpha + (1 - alpha) / 1.45)
    variance = jnp.maximum(deviation, params.noise_floor) ** 2
    truncation = params.truncation * horizontal.planes.shape[1] * variance
    cheaper = 1 - 0.75 * alpha
    support = _colour_weights(lab, params.colour, window)

    @jax.checkpoint
    def cost(disparity: Array) -> Array:
        left, right, above, below = agreement(horizontal, vertical, disparity, truncation)
        left, right, above, below = (
            _weighted_mean(part, support, window) for part in (left, right, above, below)
        )
        better = _better(left / truncation, right / truncation, alpha)
        return better + _better(above / truncation, below / truncation, alpha)

    total = aggregate(
        pooled(lax.map(cost, disparities), lab, noise, params.pooling),
        lab,
        slant=cheaper * params.slant,
        jump=cheaper * params.jump,
        colour=params.jump_colour,
    )
    return _cheapest(total, disparities)


def _cheapest(total: Float[Array, "d y x"], disparities: Float[Array, " d"]) -> Array:
    """The disparity of least cost, refined by a parabola through it and its neighbours."""
    count = disparities.shape[0]
    winner = jnp.argmin(total, axis=0)[None]
    inner = jnp.clip(winner, 1, max(count - 2, 1))

    def at(index: Array) -> Array:
        return jnp.take_along_axis(total, jnp.clip(index, 0, count - 1), axis=0)[0]

    before, here, after = at(inner - 1), at(inner), at(inner + 1)
    bend = before - 2 * here + after
    shift = 0.5 * (before - after) / jnp.where(bend > 0, bend, 1)
    shift = jnp.where((bend > 0) & (winner == inner)[0], jnp.clip(shift, -0.5, 0.5), 0)
    spacing = (disparities[-1] - disparities[0]) / (count - 1)
    return disparities[winner[0]] + spacing * shift


def _better(first: Array, second: Array, alpha: Array) -> Array:
    """The smaller of two costs; under noise softly, for the least of two is biased."""
    scale = 0.05 * jnp.where(alpha > 0, alpha, 1)

    def soft(first: Array, second: Array) -> Array:
        return jnp.minimum(first, second) - scale * jnp.log(
            0.5 * (1 + jnp.exp(-jnp.abs(first - second) / scale))
        )

    return lax.cond(alpha > 0, soft, jnp.minimum, first, second)


def _colour_weights(lab: Array, scale: Array, window: int) -> Array:
    """Weights of the neighbours, `[offset, y, x]`, that sum to 1."""
    size = 2 * window + 1
    padded = jnp.pad(lab, ((0, 0), (window, window), (window, window)), mode="edge")

    def weight(offset: Array) -> Array:
        start = (0, offset // size, offset % size)
        other = lax.dynamic_slice(padded, start, lab.shape)
        square = jnp.zeros_like(lab[0])
        for c in range(lab.shape[0]):
            square = square + (other[c] - lab[c]) ** 2
        return jnp.exp(-length(square) / scale)

    weights = lax.map(weight, jnp.arange(size * size))
    total, _ = lax.scan(lambda t, w: (t + w, None), jnp.zeros_like(lab[0]), weights)
    return weights / total[None]


def _weighted_mean(image: Array, weights: Array, window: int) -> Array:
    size = 2 * window + 1
    padded = jnp.pad(image, window, mode="edge")

    def add(total: Array, term: tuple[Array, Array]) -> tuple[Array, None]:
        offset, weight = term
        start = (offset // size, offset % size)
        return total + weight * lax.dynamic_slice(padded, start, image.shape), None

    return lax.scan(add, jnp.zeros_like(image), (jnp.arange(size * size), weights))[0]


def sweep_views(count: int) -> tuple[int, ...]:
    """Views of an arm that a sweep looks at: the ends and half of the way to them."""
    centre = count // 2
    near = centre // 2
    picked = {0, centre - near, centre + near, count - 1} - {centre}
    return tuple(sorted(picked))


def agreement(
    horizontal: Arm,
    vertical: Arm,
    disparity: Float[Array, ""],
    truncation: Float[Array, ""],
) -> tuple[Array, Array, Array, Array]:
    """Truncated squared colour difference to the centre view: left, right, upper, lower views."""
    left, right = _half_arms(horizontal, disparity, truncation)
    above, below = _half_arms(vertical, disparity, truncation)
    return left, right, above.T, below.T


def _half_arms(arm: Arm, disparity: Array, truncation: Array) -> tuple[Array, Array]:
    indices = sweep_views(arm.planes.shape[0])
    before = tuple(i for i in indices if i < arm.centre)
    after = tuple(i for i in indices if i > arm.centre)
    height, width = arm.planes.shape[2:]
    centre = [arm.planes[arm.centre, c] for c in range(arm.planes.shape[1])]

    def half(views: tuple[int, ...]) -> Array:
        def add(total: Array, view: tuple[Array, Array, Array]) -> tuple[Array, None]:
            planes, step, there = view
            shift = step * disparity
            whole = jnp.floor(shift)
            weights = _cubic(shift - whole)
            first = jnp.clip(whole.astype(jnp.int32), -width, width) + width - 1
            window = lax.dynamic_slice_in_dim(planes, first, width + 3, axis=2)
            # Colours are summed by hand: XLA on CPU does not vectorise a sum over a leading axis.
            square = jnp.zeros_like(total)
            for c, reference in enumerate(centre):
                value = sum(weights[j] * window[c, :, j : j + width] for j in range(4))
                square = square + (value - reference) ** 2
            return total + there * (truncation * square / (square + truncation)), None

        chosen = np.asarray(views, int)
        padding = ((0, 0), (0, 0), (0, 0), (width, width + 3))
        planes = jnp.pad(arm.planes[chosen], padding, mode="edge")
        there = arm.available[chosen].astype(arm.planes.dtype)
        start = jnp.zeros((height, width), arm.planes.dtype)
        total, _ = lax.scan(add, start, (planes, arm.steps[chosen], there))
        count = jnp.sum(there)
        # A half without views confirms nothing.
        return jnp.where(count > 0, total / jnp.maximum(count, 1), truncation)

    return half(before), half(after)


def _cubic(fraction: Array) -> tuple[Array, Array, Array, Array]:
    """Weights of Keys' cubic interpolation."""
    f = fraction
    return (
        -0.5 * f * (1 - f) ** 2,
        1 + 0.5 * f * f * (3 * f - 5),
        0.5 * f * (1 + f * (4 - 3 * f)),
        0.5 * f * f * (f - 1),
    )
