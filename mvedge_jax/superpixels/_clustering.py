"""Numbers and capacities of superpixels."""

import math
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from mvedge_jax._checks import expect, untraced, with_numbers
from mvedge_jax._params import at_least, number
from mvedge_jax._paths import Replaceable
from mvedge_jax.all_views import ViewDepths
from mvedge_jax.lightfield import LightField

# Pairs of labels are numbered in 32 bits.
_MOST = 32000


class SuperpixelClustering(Replaceable):
    """How superpixels are clustered: the numbers and capacities of `superpixels`.

    Attributes:
        capacity: slots for superpixels.
        margin: margin around the center view's frame for surfaces that other views show, px.
        size: side of a superpixel in the center view, px, which sets the target number; a scene
            with many smaller surfaces has more.
        color: difference of color, CIELAB, equivalent to a distance of `size`.
        depth: difference from a superpixel's plane equivalent to `size`, px per view step.
        limit: upper bound of either difference, in units of `size`, squared.
        contour: penalty of a contour per px of its length, in the same units.
        step: neighbors that differ by more are on two surfaces, px per view step.
        smallest: pieces with less of the target area join a neighbor on their surface.
        speck: surfaces with fewer pixels than this join any neighbor.
        fragment: separate pieces with fewer pixels than this in a view join a neighbor.
        slope: expected slope of a plane, px per view step and px.
        temperature: temperature of soft assignments, in the units of `limit`.
        rounds: number of clustering rounds.
        attempts: number of attempts to meet the target number of superpixels.
    """

    capacity: int = eqx.field(static=True)
    margin: int = eqx.field(static=True)
    size: Float[Array, ""] = number(20.0, "px")
    color: Float[Array, ""] = number(7.0, "CIELAB")
    depth: Float[Array, ""] = number(0.05, "px per view step")
    limit: Float[Array, ""] = number(8.0, "sizes squared")
    contour: Float[Array, ""] = number(0.48, "sizes squared per px")
    step: Float[Array, ""] = number(0.1, "px per view step")
    smallest: Float[Array, ""] = number(0.1, "share of the area")
    speck: Float[Array, ""] = number(6.0, "px")
    fragment: Float[Array, ""] = number(10.0, "px")
    slope: Float[Array, ""] = number(0.02, "px per view step and px")
    temperature: Float[Array, ""] = number(0.2, "sizes squared")
    rounds: int = eqx.field(static=True, default=10)
    attempts: int = eqx.field(static=True, default=4)

    def __check_init__(self) -> None:
        at_least(self, capacity=1, margin=0, rounds=1, attempts=1)
        if self.capacity > _MOST:
            raise ValueError(f"`capacity` must be at most {_MOST}, got {self.capacity}.")

    @staticmethod
    def for_depths(
        depths: ViewDepths, *, choices: Mapping[str, Any] | None = None
    ) -> "SuperpixelClustering":
        """Chooses capacities on the host for light fields with such depths.

        Args:
            depths: of all views, from `depth_of_views`.
            choices: numbers and static fields to set, such as `{"size": 10.0}`.

        Returns:
            The model for `superpixels`, with room for superpixels of 8 px and more. Equal static
            fields share a compiled program.

        Raises:
            TypeError: the depths are traced.
            ValueError: a name is unknown, or a choice is out of range.

        Example:
            >>> import jax.numpy as jnp
            >>> flat = jnp.ones((3, 3, 32, 32))
            >>> depths = ViewDepths(flat, flat, flat.astype(jnp.int8), jnp.asarray(0))
            >>> SuperpixelClustering.for_depths(depths).margin
            2
        """
        untraced("depths", depths.disparity)
        rows, columns, height, width = depths.disparity.shape
        most = float(np.nanmax(np.abs(np.asarray(depths.disparity)), initial=0.0))
        model = SuperpixelClustering(
            capacity=min(max(64, height * width // 32), _MOST),
            margin=math.ceil(most * (max(rows, columns) // 2)) + 1,
        )
        return model.replace(choices)


# Divisors of distances.
_UNITS = ("size", "color", "depth", "slope", "temperature")


def validate(light_field: Any, depths: Any, model: Any) -> tuple[Any, ...]:
    """Validates the arguments of `superpixels` and `soft_superpixels`."""
    order = "the order is (light_field, depths, model)"
    expect("light_field", light_field, LightField, order)
    expect("depths", depths, ViewDepths, "`depth_of_views` makes them, and " + order)
    made = "`SuperpixelClustering.for_depths(depths)` makes one, and " + order
    expect("model", model, SuperpixelClustering, made)
    model = with_numbers(model)
    for name in _UNITS:
        value = getattr(model, name)
        if not isinstance(value, Tracer) and not (np.asarray(value) > 0).all():
            raise ValueError(f"`{name}` must be positive, got {np.min(value):g}.")
    return (light_field.bare(), depths, model), {}
