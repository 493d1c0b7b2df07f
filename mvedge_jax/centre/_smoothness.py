"""Edge weights of the centre view: cut where a colour step and a depth step meet."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._params import accepts_numpy, cast, number
from mvedge_jax.image import gaussian

# The least smoothness, so that every pixel keeps a tie to its neighbours.
_FLOOR = 1e-6
# Standard deviation and reach, px, of the Gaussian that a map passes before its steps cut edges.
_BLUR, _BLUR_REACH = 0.5, 2


class SmoothnessParams(eqx.Module):
    """Parameters of the smoothness between neighbouring pixels.

    Attributes:
        colour: step of CIELAB colour at which the smoothness begins to fall.
        depth: step of disparity at which the smoothness begins to fall.
    """

    colour: Float[Array, ""] = number(0.3, "CIELAB")
    depth: Float[Array, ""] = number(0.05, "px")


@accepts_numpy
def edge_smoothness(
    lab: Float[Array, "c y x"],
    disparity: Float[Array, "y x"],
    params: SmoothnessParams,
    *,
    powers: tuple[float, float] = (1.5, 2.0),
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
        powers: a and b, how fast the smoothness falls with the steps of colour and of depth.

    Returns:
        `tx` `[y, x - 1]` and `ty` `[y - 1, x]`, in (0, 1]. Differentiable.

    Source: Thesis 4.3 and 6.1, in another form, which did better on the benchmark's scenes.
    """
    params = cast(params, disparity.dtype)

    def along(axis: int) -> Array:
        colour = jnp.zeros_like(jnp.diff(disparity, axis=axis))
        for channel in lab:
            colour = colour + jnp.diff(channel, axis=axis) ** 2
        depth = jnp.diff(disparity, axis=axis) ** 2
        edge = _power(colour / params.colour**2, 0.5 * powers[0]) * _power(
            depth / params.depth**2, 0.5 * powers[1]
        )
        return jnp.maximum(1 / (1 + edge), _FLOOR)

    return along(1), along(0)


def cuts(
    lab: Array, disparity: Array, params: SmoothnessParams, lit: Array | None
) -> tuple[Array, Array]:
    """Smoothness by the steps of a map: full between neighbours of which one is not `lit`."""
    smooth = gaussian(disparity, jnp.asarray(_BLUR, disparity.dtype), _BLUR_REACH)
    tx, ty = edge_smoothness(lab, smooth, params)
    if lit is None:
        return tx, ty
    across, down = lit[:, 1:] * lit[:, :-1], lit[1:] * lit[:-1]
    return jnp.maximum(tx, 1 - across), jnp.maximum(ty, 1 - down)


def _power(base: Array, exponent: float) -> Array:
    """`base ** exponent` with a finite gradient at zero."""
    return jnp.exp(exponent * jnp.log(base + jnp.asarray(1e-8, base.dtype)))
