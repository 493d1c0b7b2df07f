"""Splatted labels, for the points of the chain and for those of a model."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import cast

from ._raster import SplatRaster, SplatWidths
from ._splat import Splat, splat


def _narrow(scale: int = 1) -> SplatWidths:
    """Narrow widths: wider points hide the pixels beside them from other points."""
    label, weight = jnp.asarray(0.35 * scale), jnp.asarray(0.45 * scale)
    return SplatWidths(sigma_label=label, sigma_weight=weight)


def _fine(scale: int = 1) -> SplatRaster:
    return SplatRaster(scale, radius=2 * scale, tile=4 * scale, lanes=512)


class SplatLabels(eqx.Module):
    """Splats points onto a raster: super-Gaussian weights, labels composited front to back.

    Attributes:
        widths: widths and density of a point, in pixels of the raster; by default narrow ones, see
            `on_raster`.
        raster: static choices of the splat.

    Raises:
        ValueError: the points are too wide for `raster.radius`.

    Source: Thesis 7.1.2-7.1.3.
    """

    widths: SplatWidths = eqx.field(default_factory=_narrow)
    raster: SplatRaster = eqx.field(static=True, default_factory=_fine)

    def __check_init__(self) -> None:
        self.raster.check(self.widths)

    @staticmethod
    def on_raster(scale: int) -> "SplatLabels":
        """Narrow points on a raster of any scale.

        Labels are 0.35 image pixels wide and weights 0.45, whatever the raster. Such points end
        within two pixels (the opacity beyond is below 2e-6), so tiles are small and share few
        points: an optimization step takes a third of the time with the thesis' widths.

        Args:
            scale: raster pixels per image pixel and axis, 1 or 2; 1 takes a quarter of the time.

        Returns:
            The splat.

        Raises:
            ValueError: `scale` is neither.

        Example:
            >>> narrow = SplatLabels.on_raster(2)
            >>> narrow.raster.radius, round(float(narrow.widths.sigma_label), 2)
            (4, 0.7)
        """
        return SplatLabels(_narrow(scale), _fine(scale))

    @staticmethod
    def thesis() -> "SplatLabels":
        """The thesis' widths, on its raster of two pixels per image pixel and axis.

        Labels are 0.65 image pixels wide: such a point hides the pixels beside it.
        """
        return SplatLabels(SplatWidths(), SplatRaster())

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
