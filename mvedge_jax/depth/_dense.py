"""The dense part: a label at every pixel, measured in the views around a map."""

from typing import Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._params import number
from mvedge_jax.photometry.measuring import AdaptedMeasurement, PhotometricLabels

from ._labels import Labels


@runtime_checkable
class DenseLabels(Protocol):
    """Adds a label at every pixel to those of the points; called inside `jit`."""

    def __call__(
        self,
        from_points: Labels,
        measured: PhotometricLabels,
        disparity: Float[Array, "y x"],
        measuring: AdaptedMeasurement,
        precision: Float[Array, ""],
        lit: Float[Array, "y x"] | None,
    ) -> Labels:
        """Labels of the points together with one measured at every pixel.

        Args:
            from_points: labels of the points, of weight 0 where there is none.
            measured: measured disparity and variance of every pixel.
            disparity: the map around which `measured` was measured, px.
            measuring: parameters of the measurement in views of this noise.
            precision: standard error, px, at which a label counts half as much as a perfect one.
            lit: 0 where labels have no weight, 1 elsewhere; None for 1 everywhere.

        Returns:
            Positive weights and finite values. Differentiable.
        """
        ...


class MeasuredLabels(eqx.Module):
    """Dense labels weighted by their standard errors.

    Attributes:
        trust: residual of a dense label that halves its weight.
        agreement: distance of a point's label from the map at which the label keeps a quarter of
            its weight.
        anchor: weight of the previous map itself, so that no region is without any label.
    """

    trust: Float[Array, ""] = number(1.4, "noise variances")
    agreement: Float[Array, ""] = number(0.15, "px")
    anchor: Float[Array, ""] = number(1e-6, "perfect labels")

    def __call__(
        self,
        from_points: Labels,
        measured: PhotometricLabels,
        disparity: Float[Array, "y x"],
        measuring: AdaptedMeasurement,
        precision: Float[Array, ""],
        lit: Float[Array, "y x"] | None,
    ) -> Labels:
        """See `DenseLabels`."""
        weight = measured.weight(measuring, precision=precision, trust=self.trust)
        distance = (from_points.value - disparity) / self.agreement
        sparse = from_points.weight / (1 + distance**2) ** 2
        if lit is not None:
            weight, sparse = lit * weight, lit * sparse
        total = weight + sparse + self.anchor
        sums = weight * measured.disparity + sparse * from_points.value + self.anchor * disparity
        return Labels(total, sums / jnp.maximum(total, jnp.finfo(total.dtype).tiny))
