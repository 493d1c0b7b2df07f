"""The views of the losses: the center view and those compared with it."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._params import jax_array
from mvedge_jax.lightfield import LightField


class Views(eqx.Module):
    """A center view and views around it, as channel planes.

    Attributes:
        center: the image whose disparity is estimated.
        others: the views that are warped to it.
        steps: `(u_c - u, v_c - v)` of every view.
        available: views that take part.
    """

    center: Float[Array, "c y x"] = eqx.field(converter=jax_array)
    others: Float[Array, "k c y x"] = eqx.field(converter=jax_array)
    steps: Float[Array, "k 2"] = eqx.field(converter=jax_array)
    available: Bool[Array, "k"] = eqx.field(converter=jax_array)

    def take(self, index: Int[Array, "m"]) -> "Views":
        """The views at `index`."""
        return Views(self.center, self.others[index], self.steps[index], self.available[index])


def gather_views(
    light_field: LightField, *, choice: Sequence[tuple[int, int]] | None = None
) -> Views:
    """Collects the views that the losses compare with the center view.

    Args:
        light_field: the views.
        choice: grid positions `(v, u)`; by default all of the crosshair but the center.

    Returns:
        The views. Missing ones are marked as not available.

    Raises:
        ValueError: `choice` is empty or names a position outside the grid.
    """
    vc, uc = light_field.center
    rows, columns = light_field.available.shape
    if choice is None:
        choice = [(v, uc) for v in range(rows) if v != vc]
        choice += [(vc, u) for u in range(columns) if u != uc]
    if not choice:
        raise ValueError("`choice` names no view; at least one besides the center is needed.")
    for v, u in choice:
        if not (0 <= v < rows and 0 <= u < columns):
            raise ValueError(f"`choice` names view {(v, u)}; the grid is {rows}x{columns}.")
    v, u = (jnp.asarray(axis) for axis in zip(*choice, strict=True))
    return Views(
        jnp.moveaxis(light_field.center_view, -1, 0),
        jnp.moveaxis(light_field.views[v, u], -1, 1),
        light_field.steps[v, u],
        light_field.available[v, u],
    )


def all_views(light_field: LightField) -> list[tuple[int, int]]:
    """Grid positions of all available views but the center, for `gather_views`.

    Args:
        light_field: the views; `available` must be concrete, not traced.

    Returns:
        Positions `(v, u)`, row by row.
    """
    there = np.argwhere(np.asarray(light_field.available))
    return [(int(v), int(u)) for v, u in there if (v, u) != light_field.center]
