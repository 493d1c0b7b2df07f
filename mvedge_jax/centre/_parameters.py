"""Parameters (traced) and sizes (static) of the whole chain from views to depth."""

from dataclasses import dataclass
from typing import Literal, get_args

import equinox as eqx
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from mvedge_jax._params import at_least, described, number, one_of, positive
from mvedge_jax.edges import EdgeParams, EdgeSizes, scene_range
from mvedge_jax.edges.sides import BidirectionalParams, SurfaceParams
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import PhotometricParams, VolumeParams, hypothesis_count, occluder_radius

from ._sharpen import MedianParams, Sharpening
from ._smoothness import SmoothnessParams

LabelViews = Literal["crosshair", "all"]
# Ranges of files are rounded; beyond so much, px per view step, they are other ranges.
_ROUNDED = 0.02


class CentreParams(eqx.Module):
    """Parameters of the centre view's diffusion.

    Attributes:
        precision: standard error, px, at which a label counts half as much as a perfect one.
        smoothness: weight of an uncut edge between pixels against a perfect label.
        points: weight of the edge points' labels against those of the dense measurement.
        trust: residual of a dense label, in multiples of the noise variance, that halves its
            weight.
        slant: stiffness of the map's slopes, weight of an uncut edge against a perfect label.
    """

    precision: Float[Array, ""] = number(0.005, "px")
    smoothness: Float[Array, ""] = number(1.5, "perfect labels")
    points: Float[Array, ""] = number(0.5, "dense labels")
    trust: Float[Array, ""] = number(1.4, "noise variances")
    slant: Float[Array, ""] = number(30.0, "perfect labels")


class Parameters(eqx.Module):
    """The continuous parameters of `edge_to_depth`: 20 numbers, each traced and with a gradient.

    `print` shows their values and units. Filters to be learned (`EdgeParams.banks`) and the groups
    that choose sides, which matter little beside the dense measurement, are parameters if given.

    Attributes:
        edges: of the multi-view edges (Thesis 4.1).
        bidirectional: of the two directional solves (4.2.2, 4.3); None for the defaults.
        surface: of the choice of side (4.2.2); None for the defaults.
        volume: of the hypotheses that the first map starts from.
        photometric: of the dense measurement.
        smoothness: of the edge weights (6.1).
        centre: of the diffusion (6.1).
        median: of the sharpening (6.1).
    """

    edges: EdgeParams = eqx.field(default_factory=EdgeParams)
    bidirectional: BidirectionalParams | None = None
    surface: SurfaceParams | None = None
    volume: VolumeParams = eqx.field(default_factory=VolumeParams)
    photometric: PhotometricParams = eqx.field(default_factory=PhotometricParams)
    smoothness: SmoothnessParams = eqx.field(default_factory=SmoothnessParams)
    centre: CentreParams = eqx.field(default_factory=CentreParams)
    median: MedianParams = eqx.field(default_factory=MedianParams)

    def __str__(self) -> str:
        return "\n".join(described(self))


@dataclass(frozen=True)
class Sizes:
    """Static sizes and modes of `edge_to_depth`; equal ones share a compiled program.

    Attributes:
        edges: of the point stage.
        hypotheses: disparities tried per pixel.
        radius: how far occluders are looked for, px.
        views: which of them labels are measured in: `"crosshair"`, or, in two more solves at the
            end, `"all"`.
        solves: diffusions before the sharpening, and again after it.
        window: half the width of the windows in which hypotheses are compared, px.
        passes: over the neighbours whose measurements are shared, see `photometric_labels`.
        sharpening: see `sharpen`; of the first map, and again between the two rounds of solves.
        median_radius: radius of the weighted median, px.
        levels: slices of the weighted median.
        tolerance: norm of the residual over that of the right-hand side at which the diffusion
            stops; those of the slopes stop at ten times that. The two directional ones stop at an
            error of a hundred times that share of the range of their labels. Derivatives are those
            of the exact solution, whatever this is.
    """

    edges: EdgeSizes
    hypotheses: int
    radius: int
    views: LabelViews = "crosshair"
    solves: int = 2
    window: int = 2
    passes: int = 2
    sharpening: Sharpening = "clip"
    median_radius: int = 7
    levels: int = 48
    tolerance: float = 1e-5

    def __post_init__(self) -> None:
        at_least(self, hypotheses=2, radius=1, solves=1, window=0, passes=0)
        at_least(self, median_radius=1, levels=2)
        positive(self, "tolerance")
        one_of(self, views=get_args(LabelViews), sharpening=get_args(Sharpening))

    @staticmethod
    def for_light_field(light_field: LightField, **choices) -> "Sizes":
        """Chooses sizes on the host from the shape and the disparity range of a light field.

        Args:
            light_field: its range is measured where it does not come with one.
            **choices: any field of `Sizes` to set by hand, such as `views="all"`.

        Returns:
            Sizes for `edge_to_depth`.

        Raises:
            TypeError: under `jit`, where the range is traced.
            ValueError: the light field has one view only, or a choice is out of range.

        Example:
            >>> import jax.numpy as jnp
            >>> views = jnp.zeros((3, 3, 32, 32, 3))
            >>> Sizes.for_light_field(LightField(views, disparity_range=(-1.0, 1.0))).radius
            2
        """
        steps = max(light_field.centre)
        if steps == 0:
            raise ValueError(
                "`light_field` has a single view; depth needs at least three in a row or column."
            )
        low, high = scene_range(light_field)
        if light_field.disparity_range is None:
            light_field = LightField(
                light_field.views,
                available=light_field.available,
                disparity_range=(low, high),
                name=light_field.name,
            )
        height, width = light_field.views.shape[2:4]
        # Ranges of nearly equal length share a program.
        defaults = {
            "edges": EdgeSizes.for_light_field(light_field),
            "hypotheses": hypothesis_count(high - low + 0.2, steps),
            "radius": occluder_radius(high - low, steps, (height, width)),
        }
        return Sizes(**{**defaults, **choices})


def check_covers(light_field: LightField, sizes: Sizes) -> None:
    """Refuses sizes made for another range of disparities; silent under `jit`, or if none is known.

    Args:
        light_field: whose range counts.
        sizes: whose hypotheses have to cover it.

    Raises:
        ValueError: they do not.
    """
    known = light_field.disparity_range
    if known is None or isinstance(known, Tracer):
        return
    low, high = map(float, np.asarray(known))
    first, last = sizes.edges.ends
    first, last = first + sizes.edges.spacing, last - sizes.edges.spacing
    if low < first - _ROUNDED or high > last + _ROUNDED:
        raise ValueError(
            f"`sizes` look for disparities from {first:.4g} to {last:.4g}, but `light_field` says "
            f"{low:.4g} to {high:.4g} px; make them by `Sizes.for_light_field(light_field)`."
        )
