"""Parameters (traced) and sizes (static) of the depth of every view."""

from dataclasses import dataclass

import equinox as eqx
from jaxtyping import Array, Float

from mvedge_jax._params import at_least, number, positive
from mvedge_jax._paths import described
from mvedge_jax.edges import scene_range
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import hypothesis_count, occluder_radius
from mvedge_jax.photometry.matching import Matching
from mvedge_jax.photometry.measuring import Measurement
from mvedge_jax.smoothness import ColorAndDepth


class ViewParams(eqx.Module):
    """The continuous parameters of `depth_of_views`, each traced and with a gradient.

    Attributes:
        volume: of the hypotheses about surfaces that the centre view does not show.
        photometric: of their measurement.
        smoothness: of the edge weights between them.
        precision: standard error, px, at which a label counts half as much as a perfect one.
        stiffness: weight of an uncut edge between pixels against a perfect label.
        trust: residual of a label, in multiples of the noise variance, that halves its weight.
    """

    volume: Matching = eqx.field(default_factory=Matching)
    photometric: Measurement = eqx.field(default_factory=Measurement)
    smoothness: ColorAndDepth = eqx.field(default_factory=ColorAndDepth)
    precision: Float[Array, ""] = number(0.005, "px")
    stiffness: Float[Array, ""] = number(1.5, "perfect labels")
    trust: Float[Array, ""] = number(1.4, "noise variances")

    def __str__(self) -> str:
        return "\n".join(described(self))


@dataclass(frozen=True)
class ViewSizes:
    """Static sizes of `depth_of_views`; equal ones share a compiled program.

    Attributes:
        capacity: samples of surfaces that the centre view does not show; what exceeds it is counted
            and left out.
        hypotheses: disparities tried per pixel, in views of half the size.
        radius: how far occluders are looked for from one end of the grid to the other, px.
        solves: measurements, each followed by a diffusion, of what a view adds.
        passes: over the neighbours whose measurements are shared, see
            `photometry.measuring.labels`.
        tolerance: of the diffusions, relative to their right-hand sides.
    """

    capacity: int
    radius: int
    hypotheses: int
    solves: int = 2
    passes: int = 2
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        at_least(self, capacity=1, radius=1, hypotheses=2, solves=1, passes=0)
        positive(self, "tolerance")

    @staticmethod
    def for_light_field(light_field: LightField, **choices) -> "ViewSizes":
        """Chooses sizes on the host from the shape and the disparity range of a light field.

        Args:
            light_field: its range is measured where it does not come with one.
            **choices: any field of `ViewSizes` to set by hand.

        Returns:
            Sizes for `depth_of_views`.

        Raises:
            ValueError: a choice is out of range.

        Example:
            >>> import jax.numpy as jnp
            >>> views = jnp.zeros((3, 3, 32, 32, 3))
            >>> ViewSizes.for_light_field(LightField(views, disparity_range=(-1.0, 1.0))).radius
            4
        """
        low, high = scene_range(light_field)
        height, width = light_field.views.shape[2:4]
        steps = 2 * light_field.farthest
        defaults = {
            "capacity": height * width,
            "hypotheses": hypothesis_count((high - low) / 2, max(steps // 2, 1)),
            "radius": occluder_radius(high - low, max(steps, 1), (height, width)),
        }
        return ViewSizes(**{**defaults, **choices})
