"""Splatted labels: for the points of the chain and for the free points of a model."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import cast

from ._params import SplatParams, SplatSizes
from ._splat import Splat, splat

# Widths of narrow points, image pixels: wider ones hide the pixels beside them, so that no other
# point can speak there.
_LABEL, _WEIGHT = 0.35, 0.45


def _narrow() -> SplatParams:
    return SplatParams(sigma_label=jnp.asarray(_LABEL), sigma_weight=jnp.asarray(_WEIGHT))


def _one_pixel() -> SplatSizes:
    return SplatSizes(scale=1, radius=2, tile=4, lanes=512)


class SplatLabels(eqx.Module):
    """Points onto a raster: super-Gaussian weights, labels composited front to back.

    Attributes:
        widths: widths and density of a point, in pixels of the raster.
        raster: static choices of the splat.

    Source: Thesis 7.1.2-7.1.3.
    """

    widths: SplatParams = eqx.field(default_factory=_narrow)
    raster: SplatSizes = eqx.field(static=True, default_factory=_one_pixel)

    def __call__(
        self,
        xy: Float[Array, "n 2"],
        disparity: Float[Array, " n"],
        weight: Float[Array, " n"],
        valid: Bool[Array, " n"],
        shape: tuple[int, int],
        *,
        opacity: Float[Array, " n"] | None = None,
    ) -> Splat:
        """Splats points.

        Args:
            xy: positions in image pixels.
            disparity: label of each point.
            weight: data weight of each point, at least 0.
            valid: points that take part.
            shape: rows and columns of the image; the raster has `raster.scale` pixels for each.
            opacity: factor of each point's density, see `splat`.

        Returns:
            Maps on the raster. Differentiable in all but `valid`; the depth order is a selection.
        """
        scale = self.raster.scale
        return splat(
            scale * xy + (scale - 1) / 2,
            disparity,
            weight,
            valid,
            cast(self.widths, disparity.dtype),
            (shape[0] * scale, shape[1] * scale),
            self.raster,
            opacity=opacity,
        )
