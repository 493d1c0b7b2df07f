"""The rendering as the host calls it: compiled, with warnings of what the splat cuts off."""

import warnings
from typing import Any

from jaxtyping import Array, Float

from mvedge_jax._compiler import lean_jit
from mvedge_jax.splatting import Splat

from ._model import (
    DepthModel,
    ModelParams,
    ModelSizes,
    Rendered,
    opacities,
    render_model,
    splat_model,
    warn_where_known,
)

_render = lean_jit(render_model)


def compiled_render(
    model: DepthModel,
    params: ModelParams,
    sizes: ModelSizes,
    *,
    start: Float[Array, "y x"] | None = None,
) -> Rendered:
    """`render_model` as a program of its own; warns of what the splat cut off or left out.

    Args:
        model: points and smoothness.
        params: widths, density, solver.
        sizes: static choices.
        start: a map near the solution.

    Returns:
        The map.
    """
    rendered = _render(model, params, sizes, start=start)
    warn_where_known(rendered.splat)
    return rendered


@lean_jit
def _splatted(model: DepthModel, params: ModelParams, sizes: ModelSizes) -> Splat:
    opacity = opacities(model, params, sizes)
    return splat_model(model, model.log_weight, opacity, params, sizes)


def warn_of_cuts(model: DepthModel, objective: Any) -> None:
    """Warns of what the rendering within an objective cuts off or leaves out.

    Args:
        model: the points.
        objective: with `params` and `sizes` of the rendering, as `Supervised` has them; others are
            not looked at.
    """
    params, sizes = getattr(objective, "params", None), getattr(objective, "sizes", None)
    if not isinstance(params, ModelParams) or not isinstance(sizes, ModelSizes):
        return
    if sizes.splat.capacity is not None:
        warn_where_known(_splatted(model, params, sizes), level=3)
        return
    try:
        sizes.splat.check(params.splat)
    except ValueError as error:
        warnings.warn(str(error), stacklevel=3)
