"""Plane sweep of the crosshair: a baseline."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._compiler import lean_jit
from mvedge_jax._crosshair import crosshair
from mvedge_jax._params import cast
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.lightfield import LightField

from ._cost import Matching, best_match


class PlaneSweep(NamedTuple):
    """The result of `plane_sweep`.

    Attributes:
        disparity: px per view step, `[y, x]`.
        cost: least cost, `[y, x]`: 0 where the better halves of both arms agree, 2 where no
            view does.
    """

    disparity: Float[Array, "y x"]
    cost: Float[Array, "y x"]


def plane_sweep(
    light_field: LightField,
    *,
    params: Matching | None = None,
    planes: int = 64,
    window: int = 2,
    disparity_range: tuple[float, float] | Float[Array, "2"] | None = None,
) -> PlaneSweep:
    """Disparity of the center view by winner-takes-all over planes.

    The matching cost is that of `hypotheses`: truncated color differences in a color-weighted
    window, over the better half of either arm. The plane of least cost wins, and a parabola
    through its cost and those beside it gives the fraction of a plane.

    There is no regularization, so surfaces without texture are noise; noise and gains of the views
    are not measured. Planes should be no more than half a pixel apart in the outermost views.

    Args:
        light_field: the views; only the crosshair is read, never the ground truth.
        params: parameters of the cost, traced; those of paths and pooling are not read.
        planes: number of disparities, at least 2, static.
        window: half the width of the windows in which colors are compared, px, static.
        disparity_range: lowest and highest plane, px per view step, traced; the light field's own
            range by default.

    Returns:
        The disparity map with its costs. Differentiable in views and parameters through the
        parabola; the winning plane is a selection.

    Raises:
        ValueError: neither the arguments nor the light field give a disparity range.

    Source: not in the thesis; the plane sweep of Collins (1996) with the half arms of Kang et al.
    (2001).

    Example:
        >>> import jax, jax.numpy as jnp
        >>> texture = jax.random.uniform(jax.random.key(0), (1, 1, 16, 20, 3))
        >>> views = jnp.concatenate([jnp.roll(texture, s, 3) for s in (1, 0, -1)], 1)
        >>> views = jnp.concatenate([jnp.roll(views, s, 2) for s in (1, 0, -1)], 0)
        >>> result = plane_sweep(LightField(views), disparity_range=(-2.0, 2.0))
        >>> result.disparity[8, 10].round(1).item()
        1.0
    """
    wish = light_field.disparity_range if disparity_range is None else disparity_range
    if wish is None:
        raise ValueError(
            "`disparity_range` must be given as (low, high) in px per view step, as the light "
            "field does not know its own."
        )
    dtype = light_field.views.dtype
    params = cast(Matching() if params is None else params, dtype)
    for name, value, least in (("planes", planes, 2), ("window", window, 0)):
        if value < least:
            raise ValueError(f"`{name}` must be at least {least}, got {value}.")
    limits = jnp.asarray(wish, dtype)
    return _sweep(light_field.bare(), limits, params, planes=planes, window=window)


@lean_jit
def _sweep(
    light_field: LightField, limits: Array, params: Matching, *, planes: int, window: int
) -> PlaneSweep:
    lab = jnp.moveaxis(srgb_to_lab(light_field.center_view), -1, 0)
    arms, tried = crosshair(light_field), jnp.linspace(limits[0], limits[1], planes)
    return PlaneSweep(*best_match(arms, lab, tried, params, window=window))
