"""Dense labels of photographs: measured, and by hypotheses where the measurement has none."""

from jaxtyping import Array, Float

from mvedge_jax.depth import MeasuredLabels
from mvedge_jax.depth.solves import LabelContext, Labels
from mvedge_jax.photometry.measuring import PhotometricLabels


class PhotographLabels(MeasuredLabels):
    """Measured labels, and those of the hypotheses as far as the measurement leaves them weight.

    A hypothesis is rougher than a measurement, but a measurement fails where photographs from far
    apart differ in gloss or sharpness. Attributes are those of `MeasuredLabels`.
    """

    def __call__(
        self,
        from_points: Labels,
        measured: PhotometricLabels,
        disparity: Float[Array, "y x"],
        context: LabelContext,
    ) -> Labels:
        """See `DenseLabels`; `from_points` are those of the hypotheses."""
        weight = self.weight(from_points, measured, disparity, context)
        left = from_points._replace(weight=(1 - weight) * from_points.weight)
        return super().__call__(left, measured, disparity, context)
