"""Parameters (traced) and sizes (static) of the multi-view edges."""

import math
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from mvedge_jax._params import number
from mvedge_jax.epi import FilterBank, bank_radius, prewitt_bank
from mvedge_jax.lightfield import LightField

from ._range import scene_range


class EdgeParams(eqx.Module):
    """Continuous parameters of `multiview_edges`; every one is traced.

    `strength_floor` and `error_limit` are thresholds, whose derivative is 0.

    Attributes:
        banks: filters of the horizontal and of the vertical arm; None for Prewitt filters on the
            grid of `EdgeSizes`. Give them (`EdgeSizes.banks`) to learn them.
        strength_floor: weakest edge considered in a scene without noise, CIELAB units per px.
        error_limit: largest standard error of an accepted point, px, in a scene without noise.
            Wide, because each point carries its own error and weighs by it, and borders of plain
            surfaces have no better ones; with noise in proportion wider.
    """

    banks: tuple[FilterBank, FilterBank] | None = None
    strength_floor: Float[Array, ""] = number(0.1, "CIELAB/px")
    error_limit: Float[Array, ""] = number(0.1, "px")


@dataclass(frozen=True)
class EdgeSizes:
    """Static sizes of `multiview_edges`.

    Attributes:
        first: index of the first filter: its disparity is `first * spacing`.
        filters: number of filters.
        capacity: slots for points.
        spacing: spacing of the filters, px per view step. Not a parameter: it
            goes with `first` and `filters`, which set shapes.
    """

    first: int
    filters: int
    capacity: int
    spacing: float = 0.1

    def __post_init__(self):
        if not self.spacing > 0:
            raise ValueError(f"`spacing` must be positive, got {self.spacing}.")
        if self.filters < 3:
            raise ValueError(f"`filters` must be at least 3, got {self.filters}.")
        if self.capacity < 1:
            raise ValueError(f"`capacity` must be positive, got {self.capacity}.")

    def radius(self, views: int) -> int:
        """Reach of the taps for an arm of so many views, px."""
        return bank_radius(max(map(abs, self.ends)), views)

    @property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest disparity of the grid, px per view step."""
        return self.first * self.spacing, (self.first + self.filters - 1) * self.spacing

    def hypotheses(self, count: int, dtype: DTypeLike = jnp.float32) -> Float[Array, " d"]:
        """Disparities to try on the range of the bank, without its margin of one filter.

        Args:
            count: how many.
            dtype: of the result.

        Returns:
            Evenly spaced, px per view step.
        """
        low, high = self.ends
        return jnp.linspace(low + self.spacing, high - self.spacing, count, dtype=dtype)

    def banks(
        self, views: tuple[int, ...], dtype: DTypeLike = jnp.float32
    ) -> tuple[FilterBank, FilterBank]:
        """The Prewitt filters on this grid: the default, and where learning them starts.

        Args:
            views: rows and columns of the grid of views, perhaps with more after them.
            dtype: of the filters.

        Returns:
            The bank of the horizontal arm and that of the vertical one.

        Example:
            >>> across, down = EdgeSizes(first=-2, filters=5, capacity=64).banks((3, 9))
            >>> across.taps.shape[:2], down.taps.shape[:2]
            ((5, 9), (5, 3))
        """
        index = self.first + jnp.arange(self.filters, dtype=jnp.int32)
        disparity = index.astype(dtype) * self.spacing
        radius = max(self.radius(count) for count in views[:2])
        across, down = (prewitt_bank(disparity, count, radius) for count in views[1::-1])
        return across, down

    @staticmethod
    def for_light_field(light_field: LightField, *, fill: float = 0.65) -> "EdgeSizes":
        """Chooses sizes on the host, from the shape and the disparity range of a light field.

        Args:
            light_field: its range is measured where it is not given, see `scene_range`.
            fill: points per pixel to reserve.

        Returns:
            Sizes; equal ones share a compiled program.
        """
        low, high = scene_range(light_field)
        first = math.floor(round(low / EdgeSizes.spacing, 6)) - 1
        last = math.ceil(round(high / EdgeSizes.spacing, 6)) + 1
        height, width = light_field.views.shape[2:4]
        return EdgeSizes(first, last - first + 1, max(int(fill * height * width), 1))
