"""Views at any positions, the reference among them."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from mvedge_jax.lightfield import LightField

from ._parallax import GridShift, Parallax, inside, shown_at


class ViewSet(NamedTuple):
    """Views of one size, the reference first: posed photographs, or all views of a light field.

    Attributes:
        planes: sRGB, raw or calibrated, `[s, c, y, x]`.
        parallax: positions of the reference's pixels in each view.
        available: which views are read.
        shown: 1 where a view shows the scene, 0 where it is transparent; None for everywhere.
    """

    planes: Float[Array, "s c y x"]
    parallax: Parallax
    available: Bool[Array, " s"]
    shown: Float[Array, "s y x"] | None = None

    @property
    def center(self) -> Float[Array, "c y x"]:
        """The reference view."""
        return self.planes[0]

    @property
    def others(self) -> "ViewSet":
        """All views but the reference."""
        return jax.tree.map(lambda leaf: leaf[1:], self)

    def mapped(self, function: Callable[[Array], Array]) -> "ViewSet":
        """The same with a function applied to the planes."""
        return self._replace(planes=function(self.planes))

    def readable(
        self, x: Array, y: Array, shape: tuple[int, ...], own: Array | None
    ) -> Bool[Array, "*p"]:
        """Whether a single view of a set shows the scene at given positions.

        Args:
            x: columns, px.
            y: rows, px.
            shape: of the views, px.
            own: opacity of the reference's pixels, if views are partly transparent.
        """
        there = inside(x, y, shape) & self.available
        if self.shown is None or own is None:
            return there
        return there & shown_at(self.shown, x, y) & (own > 0)


def views_of(light_field: LightField) -> ViewSet:
    """All views of a light field, the center view first.

    Args:
        light_field: the views.

    Returns:
        The set. Differentiable.
    """
    views = light_field.views
    rows, columns = views.shape[:2]
    own = light_field.center[0] * columns + light_field.center[1]
    order = np.concatenate([[own], np.delete(np.arange(rows * columns), own)])

    def stack(values: Array) -> Array:
        return values.reshape(rows * columns, *values.shape[2:])[order]

    shifts = GridShift(stack(light_field.steps).astype(views.dtype))
    return ViewSet(jnp.moveaxis(stack(views), -1, 1), shifts, stack(light_field.available))
