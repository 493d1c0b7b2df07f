"""Parameters (traced) and sizes (static) of the multi-view edges."""

import math
from dataclasses import dataclass

import equinox as eqx
from jaxtyping import Array, Float

from .._params import number
from ..lightfield import LightField
from ._bank import FilterBank, bank_radius
from ._range import scene_range
from ._thesis import ThesisParams, ThesisSteps


class EdgeParams(eqx.Module):
    """Continuous parameters of `multiview_edges`; every one is traced and differentiable.

    Colours are CIE Lab or grey on a scale of 0..100.

    Attributes:
        banks: filters of the horizontal and of the vertical arm; None for Prewitt filters on the
            grid of `EdgeSizes`. Give them to learn them.
        saturation: variance over the views, grey levels squared, beyond which a pixel of a window
            counts as another surface.
        refine_saturation: the same in the refinement, whose start is known to be close.
        noise_gain: how much the variance of the scene's noise, grey levels squared, adds to
            `saturation`, `refine_saturation` and `contrast_floor`, and to 1 in the square of the
            factor on `error_limit`.
        robustness: residual of a view, relative to the contrast, that quarters its weight.
        strength_floor: weakest edge considered in a scene without noise, Lab units per px.
        contrast_floor: added to the contrast where residuals are compared with it.
        residual_limit: largest residual, relative to the contrast, of an accepted point half of
            whose neighbours agree with it; in proportion for other shares.
        dark_limit: grey level that some pixel of the 5x5 around a point must exceed: two of 255
            steps, as in the vignetted corners of a lenslet camera.
        error_limit: largest standard error of an accepted point, px, in a scene without noise.
            Noise makes good points less precise, too, and each carries its own error.
        support_radius: standard deviation, px, of the neighbourhood that votes.
        support_tolerance: disparity difference, px, at which a neighbour's vote is one half.
        confidence_scale: strength, Lab units per px, at which the confidence is one half.
        visibility_limit: largest residual of a view, relative to the contrast, that shows the
            point.
        noise_floor: variance of the quantisation, grey levels squared; 8 bits by default.
        error_floor: smallest standard error, px: interpolation and calibration are not perfect.
        thesis: parameters of the thesis' own chain, which `EdgeSizes.thesis` asks for; None for
            its defaults.
    """

    banks: tuple[FilterBank, FilterBank] | None = None
    saturation: Float[Array, ""] = number(0.2)
    refine_saturation: Float[Array, ""] = number(0.05)
    noise_gain: Float[Array, ""] = number(1.0)
    robustness: Float[Array, ""] = number(0.2)
    strength_floor: Float[Array, ""] = number(0.1)
    contrast_floor: Float[Array, ""] = number(0.05)
    residual_limit: Float[Array, ""] = number(0.4)
    dark_limit: Float[Array, ""] = number(0.8)
    error_limit: Float[Array, ""] = number(0.03)
    support_radius: Float[Array, ""] = number(2.0)
    support_tolerance: Float[Array, ""] = number(0.1)
    confidence_scale: Float[Array, ""] = number(2.0)
    visibility_limit: Float[Array, ""] = number(1.0)
    noise_floor: Float[Array, ""] = number(0.013)
    error_floor: Float[Array, ""] = number(0.0005)
    thesis: ThesisParams | None = None


@dataclass(frozen=True)
class EdgeSizes:
    """Static sizes of `multiview_edges`.

    Attributes:
        first: index of the first filter: its disparity is `first * step`.
        filters: number of filters.
        capacity: slots for points, a multiple of `chunk`.
        window: side of the window of the photo-consistency, px, odd.
        iterations: Gauss-Newton steps.
        tile: side of the tiles in which the volumes are computed, px.
        chunk: points refined at a time.
        spacing: spacing of the filters, thousandths of a px per view step. A coarse bank with a
            parabola through three filters beats a fine one: neighbours must differ. Not a
            parameter: it goes with `first` and `filters`, which set shapes.
        thesis: run the thesis' own chain, with these steps, instead of the search for
            photo-consistency; for comparison.
    """

    first: int
    filters: int
    capacity: int
    window: int = 5
    iterations: int = 2
    tile: int = 64
    chunk: int = 128
    spacing: int = 100
    thesis: ThesisSteps | None = None

    def __post_init__(self):
        if self.spacing < 1:
            raise ValueError(f"`spacing` must be positive, got {self.spacing}.")
        if self.filters < 3:
            raise ValueError(f"`filters` must be at least 3, got {self.filters}.")
        if self.window < 3 or self.window % 2 == 0:
            raise ValueError(f"`window` must be odd and at least 3, got {self.window}.")
        if self.iterations < 0:
            raise ValueError(f"`iterations` must not be negative, got {self.iterations}.")
        if self.chunk < 1 or self.capacity < self.chunk or self.capacity % self.chunk:
            raise ValueError(
                "`capacity` must be a positive multiple of `chunk`, got capacity "
                f"{self.capacity} and chunk {self.chunk}."
            )
        if self.tile < 8:
            raise ValueError(f"`tile` must be at least 8 px, got {self.tile}.")

    def radius(self, views: int) -> int:
        """Reach of the taps for an arm of so many views, px."""
        return bank_radius(max(map(abs, self.ends)), views)

    @property
    def step(self) -> float:
        """Spacing of the filters, px per view step."""
        return self.spacing / 1000

    @property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest disparity of the grid, px per view step."""
        return self.first * self.step, (self.first + self.filters - 1) * self.step

    @staticmethod
    def for_light_field(light_field: LightField, *, fill: float = 0.6) -> "EdgeSizes":
        """Chooses sizes on the host, from the shape and the disparity range of a light field.

        Args:
            light_field: its range is measured where it is not given, see `scene_range`.
            fill: points per pixel to reserve.

        Returns:
            Sizes; equal ones share a compiled program.
        """
        low, high = scene_range(light_field)
        step = EdgeSizes.spacing / 1000
        first = math.floor(round(low / step, 6)) - 1
        last = math.ceil(round(high / step, 6)) + 1
        height, width = light_field.views.shape[2:4]
        chunk = 128
        capacity = -(-int(fill * height * width) // chunk) * chunk
        tile = min(64, -(-max(height, width) // 8) * 8)
        return EdgeSizes(first, last - first + 1, max(capacity, chunk), tile=tile, chunk=chunk)
