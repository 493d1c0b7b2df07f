"""Parameters (traced) and sizes (static) of the thesis' own edge points."""

from dataclasses import dataclass
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from mvedge_jax._params import number
from mvedge_jax.edges import scene_range
from mvedge_jax.epi import FilterBank, bank_radius, exponential_disparities, prewitt_bank
from mvedge_jax.lightfield import LightField


class ThesisParams(eqx.Module):
    """Continuous parameters of `thesis_edges`; the defaults are the thesis' and its authors'.

    `floor`, `suppression` and `vote` are thresholds, whose derivative is 0.

    Attributes:
        floor: weakest response that may become a line, CIELAB units per px.
        smoothing: standard deviation of the blur before the filters, px.
        suppression: radius, as a share of the number of views, in which a line removes others.
        vote: least spatial vote of a line (Eq. 4.2).
        amplitude: first step of the entropy search, px.
        decay: factor per step.
        space_sigma: reach of the joint filter in space, px.
        disparity_sigma: in disparity, px per view step.
        colour_sigma: in colour, sRGB in [0, 1].
        banks: filters of the horizontal and of the vertical arm; None for the oriented Prewitt
            filters of `ThesisSizes`. Give them (`ThesisSizes.banks`) to learn them; disparities
            have a derivative in their taps with `ThesisSizes(interpolate=True)`.
    """

    floor: Float[Array, ""] = number(0.1, "CIELAB/px")
    smoothing: Float[Array, ""] = number(0.85, "px")
    suppression: Float[Array, ""] = number(0.2, "views")
    vote: Float[Array, ""] = number(8e-5)
    amplitude: Float[Array, ""] = number(0.15, "px")
    decay: Float[Array, ""] = number(0.88)
    space_sigma: Float[Array, ""] = number(5.0, "px")
    disparity_sigma: Float[Array, ""] = number(0.1, "px")
    colour_sigma: Float[Array, ""] = number(0.5, "sRGB")
    banks: tuple[FilterBank, FilterBank] | None = None


@dataclass(frozen=True)
class ThesisSizes:
    """Static sizes and steps of `thesis_edges`: all of the thesis' steps, but for the modulation.

    Attributes:
        reach: largest disparity of the filters in magnitude, px per view step.
        capacity: slots for points.
        filters: number of filters, see `epi.exponential_disparities`.
        lines: slots for lines per EPI.
        modulate: multiply responses by the local standard deviation (Alg. 1).
        interpolate: disparities between those of the filters, see `epi.epi_edge_map`; the thesis
            has the filters'.
        levels: scales of the spatial pyramid (4.1.4), 1 or 2.
        alignment: keep lines aligned with the gradient in a quarter of the views ("count",
            Eq. 4.3) or in four in a row ("run", the authors'), or all ("none").
        vote: keep lines with a spatial vote (4.1.3).
        entropy: search for lines of lower entropy (Eq. 4.5).
        joint: average with neighbours in space, disparity and colour (Eq. 4.6).
    """

    reach: float
    capacity: int
    filters: int = 60
    lines: int = 256
    modulate: bool = False
    interpolate: bool = False
    levels: int = 2
    alignment: Literal["none", "count", "run"] = "run"
    vote: bool = True
    entropy: bool = True
    joint: bool = True

    def __post_init__(self) -> None:
        if not self.reach > 0:
            raise ValueError(f"`reach` must be positive, got {self.reach}.")
        if self.filters < 4:
            raise ValueError(f"`filters` must be at least 4, got {self.filters}.")
        for name in ("capacity", "lines"):
            if getattr(self, name) < 1:
                raise ValueError(f"`{name}` must be positive, got {getattr(self, name)}.")
        if self.levels not in (1, 2):
            raise ValueError(f"`levels` must be 1 or 2, got {self.levels}.")
        if self.alignment not in ("none", "count", "run"):
            raise ValueError(
                f'`alignment` must be "none", "count" or "run", got {self.alignment!r}.'
            )

    def banks(
        self, views: tuple[int, ...], dtype: DTypeLike = jnp.float32
    ) -> tuple[FilterBank, FilterBank]:
        """Oriented Prewitt filters, denser around disparity 0: where learning them starts.

        Args:
            views: rows and columns of the grid of views, perhaps with more after them.
            dtype: of the filters.

        Returns:
            The bank of the horizontal arm and that of the vertical one.

        Example:
            >>> across, down = ThesisSizes(reach=1.0, capacity=64).banks((3, 9))
            >>> across.taps.shape[:2], down.taps.shape[:2]
            ((59, 9), (59, 3))
        """
        disparity = jnp.asarray(exponential_disparities(self.filters, self.reach), dtype)
        across, down = (
            prewitt_bank(disparity, count, bank_radius(self.reach, count)) for count in views[1::-1]
        )
        return across, down

    @staticmethod
    def for_light_field(light_field: LightField, **choices: Any) -> "ThesisSizes":
        """Chooses sizes on the host, from the shape and the disparity range of a light field.

        Args:
            light_field: its range is measured where it is not given, see `scene_range`.
            **choices: any field to set by hand, such as `joint=False`.

        Returns:
            Sizes; equal ones share a compiled program.
        """
        low, high = scene_range(light_field)
        height, width = light_field.views.shape[2:4]
        # A filter beyond either end of the range, so that its ends are no border of the bank.
        reach = round(1.05 * max(abs(low), abs(high), 0.1), 3)
        defaults = {"reach": reach, "capacity": max(int(0.65 * height * width), 1)}
        return ThesisSizes(**{**defaults, **choices})
