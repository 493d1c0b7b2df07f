"""Parameters (traced) and sizes (static) of the whole chain from views to depth."""

from dataclasses import dataclass
from typing import get_args

import equinox as eqx
from jaxtyping import Array, Float

from mvedge_jax._params import number
from mvedge_jax.epi import EdgeParams, EdgeSizes, scene_range
from mvedge_jax.lightfield import LightField
from mvedge_jax.occlusion import BidirectionalParams, Side, SurfaceParams
from mvedge_jax.photometry import (
    PhotometricParams,
    VolumeParams,
    hypothesis_count,
    occluder_radius,
)

from ._sharpen import MedianParams, Sharpening
from ._smoothness import SmoothnessParams


class CentreParams(eqx.Module):
    """Parameters of the centre view's diffusion.

    Attributes:
        precision: standard error, px, at which a label counts half as much as a perfect one.
        smoothness: weight of an uncut edge between pixels against a perfect label.
        points: weight of the edge points' labels against those of the dense measurement.
        agreement: disagreement of a point with the map, px, that quarters its weight.
        trust: residual of a dense label, in multiples of the noise variance, that quarters its
            weight.
        anchor: weight of the previous map itself, so that no region is without any label.
        worse: a pixel follows the sharpened map unless its residual grows by more than this factor
            (plus twice this, squared noise): the median would swallow structures that are thinner
            than half of its window, and the views know better.
        worse_first: the same where the first map is sharpened, whose thin structures are not yet
            fitted to the views.
        slant: stiffness of the map's slopes, weight of an uncut edge against a perfect label.
        steepest: differences of neighbours beyond this, px, are steps rather than slopes.
        flat: weight of the slope 0 against that of a perfect label.
        blur: standard deviation of the Gaussian that the map passes before its steps cut edges,
            px.
        tolerance: where the diffusion stops, share of the range of its labels; the two directional
            ones and those of the slopes stop at ten times that. Derivatives are those of the exact
            solution, whatever this is.
    """

    precision: Float[Array, ""] = number(0.005)
    smoothness: Float[Array, ""] = number(1.5)
    points: Float[Array, ""] = number(0.5)
    agreement: Float[Array, ""] = number(0.15)
    trust: Float[Array, ""] = number(1.4)
    anchor: Float[Array, ""] = number(1e-6)
    worse: Float[Array, ""] = number(2.0)
    worse_first: Float[Array, ""] = number(1.2)
    slant: Float[Array, ""] = number(30.0)
    steepest: Float[Array, ""] = number(0.3)
    flat: Float[Array, ""] = number(1e-4)
    blur: Float[Array, ""] = number(0.5)
    tolerance: Float[Array, ""] = number(1e-4)


class Parameters(eqx.Module):
    """Every continuous parameter of `edge_to_depth`; each is traced and has a gradient.

    Attributes:
        edges: of the multi-view edges (Thesis 4.1).
        bidirectional: of the two directional solves (4.2.2, 4.3).
        surface: of the choice of side (4.2.2).
        volume: of the hypotheses that the first map starts from.
        photometric: of the dense measurement.
        smoothness: of the edge weights (6.1).
        centre: of the diffusion (6.1).
        median: of the sharpening (6.1).
    """

    edges: EdgeParams = eqx.field(default_factory=EdgeParams)
    bidirectional: BidirectionalParams = eqx.field(default_factory=BidirectionalParams)
    surface: SurfaceParams = eqx.field(default_factory=SurfaceParams)
    volume: VolumeParams = eqx.field(default_factory=VolumeParams)
    photometric: PhotometricParams = eqx.field(default_factory=PhotometricParams)
    smoothness: SmoothnessParams = eqx.field(default_factory=SmoothnessParams)
    centre: CentreParams = eqx.field(default_factory=CentreParams)
    median: MedianParams = eqx.field(default_factory=MedianParams)


@dataclass(frozen=True)
class Sizes:
    """Static sizes and modes of `edge_to_depth`; equal ones share a compiled program.

    Attributes:
        edges: of the point stage.
        hypotheses: disparities tried per pixel.
        radius: how far occluders are looked for, px.
        dense: measure every pixel's disparity in the views, besides the points; without it only
            the points are diffused, as in the thesis.
        side: how surface vectors are chosen. `"bidirectional"`: step response of the two
            directional solves, evidence of the neighbours and of the hypotheses; `"thesis"`:
            normalised step response alone; `"reprojection"`: the map that reprojects better (Tab.
            6.2); `"naive"`: no surface vectors, labels stay on their edges (Fig. B.1).
        relaxed: keep both sides of an edge with probabilities, and share labels between the pixels
            around them that lie on their surface; else each label goes to one pixel on the side
            chosen, as in the thesis. `for_light_field` takes it where there is a dense measurement
            to tell the surfaces and the scores are those of `"bidirectional"`: from points alone
            it doubles the error of the benchmark's *backgammon*.
        solves: diffusions before the sharpening, and again after it.
        window: half the width of the windows in which hypotheses are compared, px.
        passes: over the neighbours whose measurements are shared, see `photometric_labels`.
        sharpening: see `sharpen`; of the first map, and again between the two rounds of solves.
        median_radius: radius of the weighted median, px.
        levels: slices of the weighted median.
    """

    edges: EdgeSizes
    hypotheses: int
    radius: int
    dense: bool = True
    side: Side = "bidirectional"
    relaxed: bool = False
    solves: int = 2
    window: int = 2
    passes: int = 2
    sharpening: Sharpening = "clip"
    median_radius: int = 7
    levels: int = 48

    def __post_init__(self) -> None:
        for name, least in (
            ("hypotheses", 2),
            ("radius", 1),
            ("solves", 1),
            ("window", 0),
            ("passes", 0),
            ("median_radius", 1),
            ("levels", 2),
        ):
            value = getattr(self, name)
            if value < least:
                raise ValueError(f"`{name}` must be at least {least}, got {value}.")
        for name, options in (("side", get_args(Side)), ("sharpening", get_args(Sharpening))):
            if getattr(self, name) not in options:
                raise ValueError(f"`{name}` must be one of {options}, got {getattr(self, name)!r}.")

    @staticmethod
    def for_light_field(light_field: LightField, **choices) -> "Sizes":
        """Chooses sizes on the host from the shape and the disparity range of a light field.

        Args:
            light_field: its range is measured where it does not come with one.
            **choices: any field of `Sizes` to set by hand, such as `dense=False`.

        Returns:
            Sizes for `edge_to_depth`.

        Raises:
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
        dense, side = choices.get("dense", Sizes.dense), choices.get("side", Sizes.side)
        defaults["relaxed"] = dense and side == "bidirectional"
        return Sizes(**{**defaults, **choices})
