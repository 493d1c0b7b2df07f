"""A robust second-order prior that removes noise from a map."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float

from mvedge_jax._compiler import lean_jit
from mvedge_jax._params import cast, number


class Bending(eqx.Module):
    """Parameters of polishing: scale of the noise and weight of the prior.

    Attributes:
        error: scale of the errors of the map, px; larger changes cost little more.
        bend: second difference above which a bend costs in proportion rather than by its square.
        weight: weight of the prior relative to the map.
        step: a difference that exceeds the one beside it by more than this separates surfaces, px;
            no bend is counted across it, so depth edges stay.
        jump: pixels beside steps larger than this, px, are not polished, because they are
            mixtures.
        rate: first learning rate of Adam, px.
    """

    error: Float[Array, ""] = number(0.005)
    bend: Float[Array, ""] = number(0.001)
    weight: Float[Array, ""] = number(3.0)
    step: Float[Array, ""] = number(0.03)
    jump: Float[Array, ""] = number(0.1)
    rate: Float[Array, ""] = number(5e-4)


def bending(
    disparity: Float[Array, "y x"], guide: Float[Array, "y x"], params: Bending
) -> Float[Array, ""]:
    r"""Bending energy of a map within surfaces: zero for planes of any slope.

    $$ \sum \frac{1}{b} \left(\sqrt{q^2 + b^2} - b\right) $$

    over the second differences q along x, along y and (twice) mixed, of stencils that no step of
    `guide`, which has no gradient, crosses.
    """
    params = cast(params, disparity.dtype)
    guide = jax.lax.stop_gradient(guide)
    steps_x, steps_y = _steps(guide), _steps(guide.T).T
    along_x, along_y = steps_x < params.step, steps_y < params.step
    clear = _away_from_steps(steps_x < params.jump, steps_y < params.jump)
    along_x, along_y = along_x & clear[:, 1:] & clear[:, :-1], along_y & clear[1:] & clear[:-1]
    d = disparity
    stencils = (
        (d[:, 2:] - 2 * d[:, 1:-1] + d[:, :-2], along_x[:, 1:] & along_x[:, :-1], 1),
        (d[2:] - 2 * d[1:-1] + d[:-2], along_y[1:] & along_y[:-1], 1),
        (
            d[1:, 1:] - d[1:, :-1] - d[:-1, 1:] + d[:-1, :-1],
            along_x[1:] & along_x[:-1] & along_y[:, 1:] & along_y[:, :-1],
            2,
        ),
    )
    total = jnp.zeros((), d.dtype)
    for bend, smooth, times in stencils:
        cost = jnp.sqrt(bend**2 + params.bend**2) - params.bend
        total = total + times * jnp.sum(jnp.where(smooth, cost, 0))
    return total / params.bend


def _steps(guide: Float[Array, "y x"]) -> Float[Array, "y x-1"]:
    """Excess of each difference along x over its smaller neighbor; slants have none."""
    slope = jnp.abs(jnp.diff(guide, axis=1))
    p = jnp.pad(slope, ((0, 0), (1, 1)))
    return slope - jnp.minimum(jnp.minimum(p[:, :-2], p[:, 2:]), slope)


def _away_from_steps(along_x: Bool[Array, "y w"], along_y: Bool[Array, "h x"]) -> Array:
    """Pixels without a step at any of their four edges; others may be mixtures."""
    x = jnp.pad(along_x, ((0, 0), (1, 1)), constant_values=True)
    y = jnp.pad(along_y, ((1, 1), (0, 0)), constant_values=True)
    return x[:, 1:] & x[:, :-1] & y[1:] & y[:-1]


@lean_jit
def polish(
    disparity: Float[Array, "y x"], params: Bending, *, iterations: int = 120
) -> Float[Array, "y x"]:
    r"""Removes bends that are within the error of a map.

    Minimizes $\sum \ln(1 + (D - D_0)^2 / \sigma^2)$ plus `bending`. This removes the noise of
    diffused labels and keeps steps and creases.

    Args:
        disparity: D_0, px per view step, finite.
        params: scales and weights.
        iterations: iterations of Adam.

    Returns:
        The polished map. Derivatives treat the change by polishing as a constant, because those of
        many steps on a stiff problem overflow.
    """
    params = cast(params, disparity.dtype)

    def cost(map_: Array) -> Array:
        change = (map_ - disparity) / params.error
        return jnp.sum(jnp.log1p(change**2)) + params.weight * bending(map_, disparity, params)

    adam = optax.scale_by_adam()

    def step(carry: tuple[Array, optax.OptState], fade: Array):
        map_, moments = carry
        # Optax raises a Python number to the power of its integer step count.
        with jax.numpy_dtype_promotion("standard"):
            update: Any
            update, moments = adam.update(jax.grad(cost)(map_), moments)
        return (map_ - params.rate * fade * update, moments), None

    phase = jnp.arange(iterations, dtype=disparity.dtype) / max(iterations, 1)
    fades = 0.5 * (1 + jnp.cos(jnp.pi * phase))
    (polished, _), _ = jax.lax.scan(step, (disparity, adam.init(disparity)), fades)
    return disparity + jax.lax.stop_gradient(polished - disparity)
