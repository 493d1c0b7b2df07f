"""The dense part: a label at every pixel, measured in the views around a map."""

from typing import NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._params import cast, number
from mvedge_jax.photometry.matching import Hypotheses
from mvedge_jax.photometry.measuring import AdaptedMeasurement, PhotometricLabels

from ._labels import Labels


class LabelContext(NamedTuple):
    """What dense labels are judged by, besides the measurement itself.

    Attributes:
        measuring: parameters of the measurement in views of this noise.
        precision: standard error, px, at which a label counts half as much as a perfect one.
        lab: the reference view in CIELAB, denoised, `[c, y, x]`.
        hypotheses: of the first map; None if there are none.
        lit: 0 where labels have no weight, 1 elsewhere; None for 1 everywhere.
    """

    measuring: AdaptedMeasurement
    precision: Float[Array, ""]
    lab: Float[Array, "c y x"]
    hypotheses: Hypotheses | None = None
    lit: Float[Array, "y x"] | None = None


@runtime_checkable
class DenseLabels(Protocol):
    """Adds a label at every pixel to those of the points; called inside `jit`."""

    def __call__(
        self,
        from_points: Labels,
        measured: PhotometricLabels,
        disparity: Float[Array, "y x"],
        context: LabelContext,
    ) -> Labels:
        """Labels of the points together with one measured at every pixel.

        Args:
            from_points: labels of the points, of weight 0 where there is none.
            measured: measured disparity and variance of every pixel.
            disparity: the map around which `measured` was measured, px.
            context: see `LabelContext`.

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

    def weight(
        self,
        from_points: Labels,
        measured: PhotometricLabels,
        disparity: Float[Array, "y x"],
        context: LabelContext,
    ) -> Float[Array, "y x"]:
        """Weights of the measured labels, in [0, 1]; arguments as `DenseLabels`."""
        del from_points, disparity
        return measured.weight(context.measuring, precision=context.precision, trust=self.trust)

    def __call__(
        self,
        from_points: Labels,
        measured: PhotometricLabels,
        disparity: Float[Array, "y x"],
        context: LabelContext,
    ) -> Labels:
        """See `DenseLabels`."""
        params = cast(self, disparity.dtype)
        weight = params.weight(from_points, measured, disparity, context)
        distance = (from_points.value - disparity) / params.agreement
        sparse = from_points.weight / (1 + distance**2) ** 2
        if context.lit is not None:
            weight, sparse = context.lit * weight, context.lit * sparse
        total = weight + sparse + params.anchor
        sums = weight * measured.disparity + sparse * from_points.value + params.anchor * disparity
        return Labels(total, sums / jnp.maximum(total, jnp.finfo(total.dtype).tiny))
