"""Rendering on the host: compiled, with warnings of points that the splat cuts off."""

import warnings
from typing import Any

from jaxtyping import Array, Float

from mvedge_jax._compiler import lean_jit
from mvedge_jax.splatting import Splat

from ._model import (
    DepthModel,
    Rendered,
    Renderer,
    opacities,
    render_model,
    splat_model,
    warn_where_known,
)

_render = lean_jit(render_model)


def compiled_render(
    model: DepthModel, renderer: Renderer, *, start: Float[Array, "y x"] | None = None
) -> Rendered:
    """`render_model`, compiled; warns of points that the splat cuts off or leaves out."""
    rendered = _render(model, renderer, start=start)
    warn_where_known(rendered.splat)
    return rendered


@lean_jit
def _splatted(model: DepthModel, renderer: Renderer) -> Splat:
    return splat_model(model, model.log_weight, opacities(model, renderer), renderer)


def warn_of_cuts(model: DepthModel, objective: Any) -> None:
    """Warns of points that the `renderer` of an objective, if any, cuts off or leaves out."""
    renderer = getattr(objective, "renderer", None)
    if not isinstance(renderer, Renderer):
        return
    splat = renderer.splat
    if splat.raster.capacity is not None:
        warn_where_known(_splatted(model, renderer), level=3)
        return
    try:
        splat.raster.check(splat.widths)
    except ValueError as error:
        warnings.warn(str(error), stacklevel=3)
