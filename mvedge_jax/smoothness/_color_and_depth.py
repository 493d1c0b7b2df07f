"""Edge weights that are cut where a color step and a depth step meet."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._params import accepts_numpy, at_least, cast, number
from mvedge_jax.image import gaussian


class ColorAndDepth(eqx.Module):
    """Smoothness by the product of color and depth steps: the default.

    Attributes:
        color: step of CIELAB color at which the smoothness begins to fall.
        depth: step of disparity at which the smoothness begins to fall.
        color_power: how fast the smoothness falls with the step of color.
        depth_power: how fast the smoothness falls with the step of disparity.
        blur: standard deviation of the Gaussian that blurs the map before its steps are taken.
        floor: least smoothness, so that no pixel is cut off from its neighbors.
        reach: radius of that Gaussian, px.
    """

    color: Float[Array, ""] = number(0.3, "CIELAB")
    depth: Float[Array, ""] = number(0.05, "px")
    color_power: Float[Array, ""] = number(1.5)
    depth_power: Float[Array, ""] = number(2.0)
    blur: Float[Array, ""] = number(0.5, "px")
    floor: Float[Array, ""] = number(1e-6)
    reach: int = eqx.field(static=True, default=2)

    def __check_init__(self) -> None:
        at_least(self, reach=1)

    def __call__(
        self,
        guide: Float[Array, "c y x"],
        disparity: Float[Array, "y x"],
        depth_edge: Float[Array, "y x"],
    ) -> tuple[Float[Array, "y x-1"], Float[Array, "y-1 x"]]:
        """See `Smoothness`; the steps of the map replace `depth_edge`."""
        del depth_edge
        smooth = gaussian(disparity, self.blur.astype(disparity.dtype), self.reach)
        return edge_smoothness(guide, smooth, self)


@accepts_numpy
def edge_smoothness(
    lab: Float[Array, "c y x"], disparity: Float[Array, "y x"], params: ColorAndDepth
) -> tuple[Float[Array, "y x-1"], Float[Array, "y-1 x"]]:
    r"""Smoothness per edge between neighboring pixels, without the blur.

    $$ t = \max\left(\frac{1}{1 + (|\Delta Lab| / c)^a (|\Delta D| / s)^b},\; t_0\right) $$

    The thesis takes one number per pixel from the gradients of the image and of the two
    directional passes. The *product* of both steps finds occlusion edges: texture has no depth
    step, and a slanted surface no color step. Differences per edge instead of a Sobel filter per
    pixel keep structures that are two pixels wide.

    Args:
        lab: center view in CIELAB, L in 0..100, `[c, y, x]`.
        disparity: a map from an earlier pass, px per view step, `[y, x]`.
        params: c, s, a and b, and `floor`, t0.

    Returns:
        `tx` `[y, x - 1]` and `ty` `[y - 1, x]`, in (0, 1]. Differentiable.

    Source: Thesis 4.3 and 6.1, in another form with lower errors on the benchmark's scenes.
    """
    params = cast(params, disparity.dtype)

    def along(axis: int) -> Array:
        color = jnp.zeros_like(jnp.diff(disparity, axis=axis))
        for channel in lab:
            color = color + jnp.diff(channel, axis=axis) ** 2
        depth = jnp.diff(disparity, axis=axis) ** 2
        edge = _power(color / params.color**2, 0.5 * params.color_power) * _power(
            depth / params.depth**2, 0.5 * params.depth_power
        )
        return jnp.maximum(1 / (1 + edge), params.floor)

    return along(1), along(0)


def _power(base: Array, exponent: Array) -> Array:
    """`base ** exponent` with a finite gradient at zero."""
    return jnp.exp(exponent * jnp.log(base + jnp.asarray(1e-8, base.dtype)))
