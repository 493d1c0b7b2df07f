"""Edge weights of the centre view: cut where a colour step and a depth step meet."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._params import cast, number


class SmoothnessParams(eqx.Module):
    """Parameters of the smoothness between neighbouring pixels.

    Attributes:
        colour: step of CIELAB colour at which the smoothness begins to fall.
        colour_power: how fast it falls with the colour step.
        depth: step of disparity, px, at which the smoothness begins to fall.
        depth_power: how fast it falls with the depth step.
        floor: the least smoothness, so that every pixel keeps a tie to its neighbours.
    """

    colour: Float[Array, ""] = number(0.3)
    colour_power: Float[Array, ""] = number(1.5)
    depth: Float[Array, ""] = number(0.05)
    depth_power: Float[Array, ""] = number(2.0)
    floor: Float[Array, ""] = number(1e-6)


def edge_smoothness(
    lab: Float[Array, "c y x"], disparity: Float[Array, "y x"], params: SmoothnessParams
) -> tuple[Float[Array, "y x-1"], Float[Array, "y-1 x"]]:
    r"""Smoothness per edge between neighbouring pixels.

    $$ t = \max\left(\frac{1}{1 + (|\Delta Lab| / c)^a (|\Delta D| / s)^b},\; t_0\right) $$

    The thesis takes one number per pixel from the gradients of the image and of the two
    directional passes. The *product* of both steps is what finds occlusion edges: texture has
    no depth step, and a slanted surface no colour step. Differences per edge instead of a
    Sobel filter per pixel keep structures that are two pixels wide.

    Args:
        lab: centre view in CIELAB, L in 0..100, `[c, y, x]`.
        disparity: a map from an earlier pass, px per view step, `[y, x]`.
        params: see `SmoothnessParams`.

    Returns:
        `tx` `[y, x - 1]` and `ty` `[y - 1, x]`, in (0, 1]. Differentiable.

    Source: Thesis 4.3 and 6.1, in another form (REFERENCE: measured on the benchmark).
    """
    params = cast(params, disparity.dtype)

    def along(axis: int) -> Array:
        colour = jnp.zeros_like(jnp.diff(disparity, axis=axis))
        for channel in lab:
            colour = colour + jnp.diff(channel, axis=axis) ** 2
        depth = jnp.diff(disparity, axis=axis) ** 2
        edge = _power(colour / params.colour**2, 0.5 * params.colour_power) * _power(
            depth / params.depth**2, 0.5 * params.depth_power
        )
        return jnp.maximum(1 / (1 + edge), params.floor)

    return along(1), along(0)


def _power(base: Array, exponent: Array) -> Array:
    """`base ** exponent` with a finite gradient at zero."""
    return jnp.exp(exponent * jnp.log(base + jnp.asarray(1e-8, base.dtype)))
