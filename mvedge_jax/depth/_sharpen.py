"""Sharpening: depth steps are moved onto color steps."""

from typing import Literal, get_args

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._params import accepts_numpy, at_least, cast, number, one_of

from ._median import weighted_median

Sharpening = Literal["clip", "median", "quantized", "none"]


class Sharpen(eqx.Module):
    """Moves blurred depth steps onto the color steps beside them, by a weighted median.

    Attributes:
        epsilon: regularization of the guided filter.
        slack: with `"clip"`, how far the map may stay from the median.
        radius: radius of the guided filter, px.
        levels: number of slices of the range of disparities.
        mode: `"median"` interpolates the median between slices; `"clip"` keeps the map, and so its
            precision, within `slack` of that median; `"quantized"` returns the slice itself, as
            the thesis does, and has no derivative; `"none"` changes nothing.

    Source: Thesis 6.1, "Cross-hair View Projection"; the interpolation and the clip are ours.

    Example:
        >>> import jax.numpy as jnp
        >>> step = jnp.where(jnp.arange(32) < 16, 0.0, 1.0)
        >>> guide = jnp.broadcast_to(step, (3, 16, 32))
        >>> blurred = jnp.broadcast_to(jnp.clip(jnp.arange(32) / 8 - 1.5, 0.0, 1.0), (16, 32))
        >>> sharp = Sharpen()(blurred, guide)
        >>> [round(float(jnp.abs(m - step[None]).max()), 2) for m in (blurred, sharp)]
        [0.5, 0.18]
    """

    epsilon: Float[Array, ""] = number(1e-6, "sRGB²")
    slack: Float[Array, ""] = number(0.03, "px")
    radius: int = eqx.field(static=True, default=7)
    levels: int = eqx.field(static=True, default=48)
    mode: Sharpening = eqx.field(static=True, default="clip")

    def __check_init__(self) -> None:
        at_least(self, radius=1, levels=2)
        one_of(self, mode=get_args(Sharpening))

    @accepts_numpy
    def __call__(
        self,
        disparity: Float[Array, "y x"],
        guide: Float[Array, "c y x"],
        *,
        ends: tuple[Float[Array, ""], Float[Array, ""]] | None = None,
    ) -> Float[Array, "y x"]:
        """Sharpens a map.

        Args:
            disparity: px per view step, `[y, x]`.
            guide: the center view, sRGB, three channels `[c, y, x]`.
            ends: least and largest disparity of the whole map, if `disparity` is a part of it.

        Returns:
            The sharpened map. Differentiable; which level crosses one half is a selection.
        """
        if self.mode == "none":
            return disparity
        params = cast(self, disparity.dtype)
        median = weighted_median(
            disparity,
            guide,
            params.epsilon,
            radius=self.radius,
            levels=self.levels,
            quantized=self.mode == "quantized",
            ends=ends,
        )
        if self.mode == "clip":
            return jnp.clip(disparity, median - params.slack, median + params.slack)
        return median
