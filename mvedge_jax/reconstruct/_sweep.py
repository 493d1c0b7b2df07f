"""Plane sweep of the crosshair: the baseline that the method has to beat."""

import dataclasses
import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._params import cast, number
from ..lightfield import LightField


class SweepParams(eqx.Module):
    """What `plane_sweep` can tune; traced.

    Attributes:
        scale: Colour difference at which the cost of a view is one half, root mean square over
            the channels of sRGB in [0, 1]; raise it for noisy views.
        sigma: Standard deviation of the Gaussian window over which costs are averaged, px; 0 for
            single pixels.
        margin: By how much one half of an arm has to be cheaper than the whole arm to be believed
            instead, 0..1: a surface that an occluder hides on one side is seen on the other. 1 or
            more always takes the whole arm.
    """

    scale: Float[Array, ""] = number(0.01)
    sigma: Float[Array, ""] = number(1.5)
    margin: Float[Array, ""] = number(0.1)


@dataclasses.dataclass(frozen=True)
class SweepSizes:
    """The static choices of `plane_sweep`.

    Attributes:
        planes: Number of disparities that are tried, at least 2.
        radius: Half width of the window, px: the Gaussian is cut there.
    """

    planes: int = 64
    radius: int = 3

    def __post_init__(self):
        if self.planes < 2:
            raise ValueError(f"`planes` must be at least 2, got {self.planes}.")
        if self.radius < 0:
            raise ValueError(f"`radius` must be at least 0, got {self.radius}.")


class Sweep(NamedTuple):
    """The result of `plane_sweep`.

    Attributes:
        disparity: `[y, x]`, px per view step.
        cost: Cost of the winner, `[y, x]`, 0..1.
        plane: Index of the winning plane, `[y, x]`.
    """

    disparity: Float[Array, "y x"]
    cost: Float[Array, "y x"]
    plane: Int[Array, "y x"]


def plane_sweep(
    light_field: LightField,
    *,
    params: SweepParams | None = None,
    sizes: SweepSizes | None = None,
    disparity_range: tuple[float, float] | Float[Array, "2"] | None = None,
) -> Sweep:
    r"""Disparity of the centre view by winner-takes-all over planes.

    For each of `sizes.planes` equally spaced disparities the views of the crosshair are shifted to
    the centre view (cubic interpolation) and compared with it. With e the root-mean-square
    difference of the channels and s = `params.scale`, a view costs $e^2 / (e^2 + s^2)$. Costs are
    averaged over the views of an arm, or over its better half where that is clearly cheaper
    (occlusion), then over a Gaussian window. The cheapest plane wins, and a parabola through its
    cost and its neighbours' gives the fraction of a plane.

    There is no regularisation: surfaces without texture come out as noise, which is what a
    baseline is for. Planes should be no more than half a pixel apart in the outermost views.
    Memory does not grow with their number.

    Args:
        light_field: The views; only the crosshair is read, never the ground truth.
        params: Tuning, traced; the defaults suit noise-free 8-bit views.
        sizes: Number of planes, window and occlusion handling, static.
        disparity_range: Lowest and highest plane, px per view step, traced; the light field's own
            range by default.

    Returns:
        The disparity map with its costs. Differentiable with respect to views and parameters
        through the parabola only, the winning plane being held fixed.

    Raises:
        ValueError: if neither the arguments nor the light field tell the disparity range.

    Source: not in the thesis; the plane sweep of Collins (1996) with the half arms of Kang et al.
    (2001).

    Example:
        >>> import jax, jax.numpy as jnp
        >>> texture = jax.random.uniform(jax.random.key(0), (1, 1, 16, 20, 3))
        >>> views = jnp.concatenate([jnp.roll(texture, s, 3) for s in (1, 0, -1)], 1)
        >>> views = jnp.concatenate([jnp.roll(views, s, 2) for s in (1, 0, -1)], 0)
        >>> result = plane_sweep(LightField(views), disparity_range=(-2.0, 2.0))
        >>> result.disparity[8, 10].round(1).item()
        1.0
    """
    wish = light_field.disparity_range if disparity_range is None else disparity_range
    if wish is None:
        raise ValueError(
            "`disparity_range` must be given as (low, high) in px per view step, as the light "
            "field does not know its own."
        )
    dtype = light_field.views.dtype
    limits = jnp.asarray(wish, dtype)
    return _sweep(
        light_field.without_truth(),
        cast(params or SweepParams(), dtype),
        limits,
        sizes or SweepSizes(),
    )


class _Arm(NamedTuple):
    """Views of one arm by side of the centre: `h` halves of `n` views, channels first."""

    cyclic: Float[Array, "h n c y w"]  # repeated along x, so that a shift is a contiguous slice
    steps: Float[Array, "h n"]
    available: Bool[Array, "h n"]


def _arm(views: Array, steps: Array, available: Array) -> _Arm:
    half = views.shape[0] // 2

    def halves(values: Array) -> Array:
        return jnp.stack([values[:half], values[half + 1 :]])

    views = jnp.moveaxis(views, -1, 1)
    cyclic = jnp.concatenate([views, views, views[..., :3]], -1)
    return _Arm(halves(cyclic), halves(steps), halves(available))


def _half_cost(
    half: _Arm, centre: Float[Array, "c y x"], disparity: Float[Array, ""], params: SweepParams
) -> tuple[Float[Array, "y x"], Float[Array, " x"]]:
    """Sum of costs of the views on one side, and how many views there are per column."""
    width = centre.shape[-1]
    x = jnp.arange(width, dtype=centre.dtype)

    def add(total, item):
        view, step, available = item
        shift = step * disparity
        whole = jnp.floor(shift)
        start = jnp.mod(whole.astype(jnp.int32) - 1, width)
        weights = _cubic(shift - whole)
        # One sum over channels, written out: as a reduction it costs three times as much on a CPU.
        error = jnp.zeros_like(centre[0])
        for channel in range(centre.shape[0]):
            window = jax.lax.dynamic_slice_in_dim(view[channel], start, width + 3, axis=1)
            taps = [weight * window[:, k : k + width] for k, weight in enumerate(weights)]
            error += (taps[0] + taps[1] + taps[2] + taps[3] - centre[channel]) ** 2
        error /= centre.shape[0]
        cost = error / (error + params.scale**2)
        # What came around from the other side of the image does not count.
        inside = (x + shift >= 0) & (x + shift <= width - 1) & available
        inside = inside.astype(cost.dtype)
        return (total[0] + cost * inside[None, :], total[1] + inside), None

    empty = (jnp.zeros_like(centre[0]), jnp.zeros_like(x))
    return jax.lax.scan(add, empty, half)[0]


def _cubic(f: Float[Array, ""]) -> tuple[Array, Array, Array, Array]:
    """Weights of Catmull-Rom interpolation at the fraction `f` between the middle taps."""
    return (
        f * (-0.5 + f * (1 - 0.5 * f)),
        1 + f * f * (-2.5 + 1.5 * f),
        f * (0.5 + f * (2 - 1.5 * f)),
        f * f * (-0.5 + 0.5 * f),
    )


def _arm_cost(arm: _Arm, centre: Array, disparity: Array, params: SweepParams) -> Array:
    """Cost per pixel of one plane according to one arm, `[y, x]`."""
    total, count = jax.lax.map(lambda half: _half_cost(half, centre, disparity, params), arm)
    count = count[:, None, :]
    whole = total.sum(0) / jnp.maximum(count.sum(0), 1)
    half = jnp.where(count > 0, total / jnp.maximum(count, 1), 1).min(0)
    # A half is believed only if it is clearly better: the smaller of two noisy halves would be
    # cheapest beside the right plane.
    return jnp.where(count.sum(0) > 0, jnp.minimum(whole, half + params.margin), 1)


def _blur(image: Float[Array, "y x"], sigma: Float[Array, ""], radius: int) -> Array:
    """Gaussian average with mirrored borders."""
    if radius == 0:
        return image
    offsets = jnp.arange(-radius, radius + 1, dtype=image.dtype)
    positive = sigma > 0
    taps = jnp.exp(-0.5 * (offsets / jnp.where(positive, sigma, 1)) ** 2)
    taps = jnp.where(positive, taps, (offsets == 0).astype(image.dtype))
    taps = taps / taps.sum()
    height, width = image.shape
    padded = jnp.pad(image, radius, mode="symmetric")
    rows = [tap * padded[k : k + height] for k, tap in enumerate(taps)]
    padded = functools.reduce(jnp.add, rows)
    return functools.reduce(jnp.add, [tap * padded[:, k : k + width] for k, tap in enumerate(taps)])


@eqx.filter_jit
def _sweep(light_field: LightField, params: SweepParams, limits: Array, sizes: SweepSizes) -> Sweep:
    vc, uc = light_field.centre
    steps = light_field.steps
    centre = jnp.moveaxis(light_field.centre_view, -1, 0)
    across = _arm(light_field.horizontal_arm, steps[vc, :, 0], light_field.available[vc])
    # The vertical arm is swept as a horizontal one of the transposed images.
    down = jnp.swapaxes(light_field.vertical_arm, 1, 2)
    down = _arm(down, steps[:, uc, 1], light_field.available[:, uc])
    turned = jnp.swapaxes(centre, 1, 2)
    spacing = (limits[1] - limits[0]) / (sizes.planes - 1)

    def cost(disparity: Array) -> Array:
        horizontal = _arm_cost(across, centre, disparity, params)
        vertical = _arm_cost(down, turned, disparity, params)
        return _blur(0.5 * (horizontal + vertical.T), params.sigma, sizes.radius)

    def visit(state, index: Array):
        best, winner, before, after, previous = state
        now = cost(limits[0] + spacing * index.astype(limits.dtype))
        after = jnp.where(winner == index - 1, now, after)
        better = now < best
        state = (
            jnp.where(better, now, best),
            jnp.where(better, index, winner),
            jnp.where(better, previous, before),
            after,
            now,
        )
        return state, None

    # Worst possible neighbours at the ends of the range: the parabola then stays on the plane.
    far = jnp.full(centre.shape[1:], jnp.inf, centre.dtype)
    start = (far, jnp.full(centre.shape[1:], -2, jnp.int32), far, far, far)
    (best, winner, before, after, _), _ = jax.lax.scan(
        visit, start, jnp.arange(sizes.planes, dtype=jnp.int32)
    )
    inner = (winner > 0) & (winner < sizes.planes - 1)
    bend = jnp.where(inner, before - 2 * best + after, 1)
    lean = jnp.where(inner, before - after, 0)
    fraction = jnp.where(bend > 0, 0.5 * lean / jnp.where(bend > 0, bend, 1), 0)
    disparity = limits[0] + spacing * (winner.astype(limits.dtype) + jnp.clip(fraction, -0.5, 0.5))
    return Sweep(disparity, best, winner)
