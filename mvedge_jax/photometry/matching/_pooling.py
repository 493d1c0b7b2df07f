"""Pooling of matching costs in noisy views, where a window of 5x5 px is too small."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._cpu import plane_sum
from mvedge_jax._params import at_least, cast, number
from mvedge_jax._root import safe_sqrt
from mvedge_jax.image import gaussian, highest

from ..brightness._noise import Noise

# Disparities filtered together: trades memory against speed; results do not depend on it.
_SLAB = 8


class Pooling(eqx.Module):
    """Parameters of the averaging of matching costs along surfaces in noisy views.

    Attributes:
        length: standard deviation of the filter within one color.
        step: step of the guide, per unit of noise, that attenuates pooling as much as `length`.
        reach: distance from an outline within which costs are those of the nearer surface, px.
    """

    length: Float[Array, ""] = number(20.0, "px")
    step: Float[Array, ""] = number(400.0, "CIELAB per sRGB of noise")
    reach: int = eqx.field(static=True, default=6)

    def __check_init__(self) -> None:
        at_least(self, reach=1)


def pooled(
    cost: Float[Array, "d y x"],
    lab: Float[Array, "c y x"],
    noise: Noise,
    params: Pooling,
) -> Float[Array, "d y x"]:
    """Averages every slice of a matching cost along the surfaces of an image.

    A recursive filter along rows and columns, twice, stops where the guide's color changes. Costs
    within `reach` of a strong edge have little weight: they are those of the nearer surface on
    both of its sides and would spread onto the farther one.

    Args:
        cost: per disparity and pixel, `[d, y, x]`.
        lab: the denoised center view in CIELAB, `[c, y, x]`.
        noise: pooling fades with its `alpha`.
        params: see `Pooling`.

    Returns:
        The averages, `[d, y, x]`; `cost` itself where `noise.alpha` is 0. Differentiable.

    Source: not in the thesis; Gastal and Oliveira (2011), "Domain transform for edge-aware image
        and video processing".

    Example:
        >>> import jax, jax.numpy as jnp
        >>> cost = jax.random.uniform(jax.random.key(0), (2, 32, 32))
        >>> flat, strong = jnp.zeros((3, 32, 32)), Noise.of(jnp.asarray(0.05))
        >>> float(pooled(cost, flat, strong, Pooling(length=10.0)).std()) < 0.1
        True
    """
    params = cast(params, cost.dtype)

    def filtered(cost: Array) -> Array:
        reach = params.length * noise.alpha
        unit = reach / (params.step * noise.deviation)
        steps = unit * _distance(lab, 0), unit * _distance(lab, 1)
        trust = 1 / (1 + highest(_gradient(lab), params.reach) ** 4) + 1e-6

        @jax.checkpoint
        def some(slab: Array) -> Array:
            return _smooth(slab, steps, reach)

        # The weights are filtered as one more slice. In slabs, to limit the memory of reverse
        # mode.
        count = cost.shape[0]
        slabs = -(-(count + 1) // _SLAB)
        spare = slabs * _SLAB - count - 1
        whole = jnp.concatenate(
            [trust[None] * cost, trust[None], jnp.zeros((spare, *trust.shape), cost.dtype)]
        )
        out = lax.map(some, whole.reshape(slabs, _SLAB, *trust.shape)).reshape(whole.shape)
        return out[:count] / out[count][None]

    return lax.cond(noise.alpha > 0, jax.checkpoint(filtered), lambda cost: cost, cost)


def _gradient(lab: Float[Array, "c y x"]) -> Float[Array, "y x"]:
    """Lab units per px, after a blur of 1 px."""
    soft = gaussian(lab, jnp.ones((), lab.dtype), 3)
    wide = jnp.pad(soft, ((0, 0), (1, 1), (1, 1)), mode="edge")
    across, down = wide[:, 1:-1, 2:] - wide[:, 1:-1, :-2], wide[:, 2:, 1:-1] - wide[:, :-2, 1:-1]
    return safe_sqrt(plane_sum(0.25 * (across**2 + down**2)))


def _distance(lab: Float[Array, "c y x"], axis: int) -> Array:
    """Color step between each pixel and the one before it along an axis, 0 for the first."""
    margin = [(0, 0), (0, 0)]
    margin[axis] = (1, 0)
    return safe_sqrt(jnp.pad(plane_sum(jnp.diff(lab, axis=1 + axis) ** 2), margin))


def _smooth(volume: Array, steps: tuple[Array, Array], length: Array) -> Array:
    """The recursive filter, in two rounds whose variances add up to the square of `length`."""
    length = jnp.maximum(length, 0.1)
    shares = jnp.asarray([2.0, 1.0], volume.dtype)[:, None, None]
    scale = -((2.0 * 15 / 3) ** 0.5) / (shares * length)
    columns, rows = jnp.exp(scale * (1 + steps[1].T[None])), jnp.exp(scale * (1 + steps[0][None]))

    def round_of(across: Array, feedback: tuple[Array, Array]) -> tuple[Array, None]:
        for along in feedback:
            across = jnp.transpose(_both_ways(across, along[:, None]), (2, 1, 0))
        return across, None

    across, _ = lax.scan(round_of, jnp.transpose(volume, (2, 0, 1)), (columns, rows))
    return jnp.transpose(across, (1, 2, 0))


def _both_ways(volume: Array, feedback: Array) -> Array:
    """First-order recursion along the first axis and back; each item takes from the one before."""

    def visit(before: Array, item: tuple[Array, Array]) -> tuple[Array, Array]:
        own, share = item
        now = own + share * (before - own)
        return now, now

    forward = lax.scan(visit, volume[0], (volume, feedback))[1]
    following = jnp.concatenate([feedback[1:], jnp.zeros_like(feedback[:1])])
    return lax.scan(visit, forward[-1], (forward, following), reverse=True)[1]
