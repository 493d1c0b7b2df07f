"""The parts of the depth of every view."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
from jaxtyping import Array, Float

from mvedge_jax._params import as_number, at_least, number, positive
from mvedge_jax._paths import Replaceable
from mvedge_jax.edges import scene_range
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import hypothesis_count, occluder_radius
from mvedge_jax.photometry.brightness import Brightness
from mvedge_jax.photometry.matching import Matching
from mvedge_jax.photometry.measuring import Measurement
from mvedge_jax.smoothness import ColorAndDepth
from mvedge_jax.warping import Outline


def _outline() -> Outline:
    """A weaker prior than for solved maps."""
    return Outline(odds=as_number(0.25))


class ViewDepth(Replaceable):
    """Depth of every view, with measurement of surfaces that the center view does not show.

    Attributes:
        matching: costs of the hypotheses about such surfaces.
        measurement: measurement of their pixels. `radius` is the largest distance of occluders
            from one end of the grid to the other; `views` is not read.
        smoothness: weights of the edges between neighboring pixels.
        brightness: parameters of the gains of all views and of the denoising of guides.
        outline: assigns a pixel beside a step to one surface. Its prior odds are those that
            drawing, which rounds samples to whole pixels, chose the right side; chosen on demo,
            crossing, thin.
        precision: standard error at which a label counts half as much as a perfect one.
        stiffness: weight of an uncut edge between pixels relative to a perfect label.
        trust: residual of a label that halves its weight.
        capacity: slots for samples of surfaces that the center view does not show; overflow is
            counted and left out.
        hypotheses: disparities tried per pixel, in views of half the size.
        solves: number of measurements, each followed by a diffusion, of the surfaces that a view
            adds.
        tolerance: relative residual of the diffusions.
    """

    capacity: int = eqx.field(static=True)
    hypotheses: int = eqx.field(static=True)
    measurement: Measurement
    matching: Matching = eqx.field(default_factory=Matching)
    smoothness: ColorAndDepth = eqx.field(default_factory=ColorAndDepth)
    brightness: Brightness = eqx.field(default_factory=Brightness)
    outline: Outline = eqx.field(default_factory=_outline)
    precision: Float[Array, ""] = number(0.005, "px")
    stiffness: Float[Array, ""] = number(1.5, "perfect labels")
    trust: Float[Array, ""] = number(1.4, "noise variances")
    solves: int = eqx.field(static=True, default=2)
    tolerance: float = eqx.field(static=True, default=1e-4)

    def __check_init__(self) -> None:
        at_least(self, capacity=1, hypotheses=2, solves=1)
        positive(self, "tolerance")

    @staticmethod
    def for_light_field(
        light_field: LightField, *, choices: Mapping[str, Any] | None = None
    ) -> "ViewDepth":
        """Chooses capacities on the host from the shape and the disparity range of a light field.

        Args:
            light_field: its range is measured if it has none.
            choices: numbers and static fields to set, by path, such as
                `{"measurement.radius": 8}`.

        Returns:
            The model for `depth_of_views`. Equal static fields share a compiled program.

        Raises:
            ValueError: a path is unknown, or a choice is out of range.

        Example:
            >>> import jax.numpy as jnp
            >>> views = jnp.zeros((3, 3, 32, 32, 3))
            >>> flat = LightField(views, disparity_range=(-1.0, 1.0))
            >>> ViewDepth.for_light_field(flat).measurement.radius
            4
        """
        low, high = scene_range(light_field)
        height, width = light_field.views.shape[2:4]
        steps = 2 * light_field.farthest
        radius = occluder_radius(high - low, max(steps, 1), (height, width))
        model = ViewDepth(
            capacity=height * width,
            hypotheses=hypothesis_count((high - low) / 2, max(steps // 2, 1)),
            measurement=Measurement(radius=radius),
        )
        return model.replace(choices)
