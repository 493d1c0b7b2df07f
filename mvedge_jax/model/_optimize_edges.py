"""Self-supervised optimization of the model against the views, in one call."""

from collections.abc import Callable

import jax
from jaxtyping import PRNGKeyArray

from mvedge_jax._params import accepts_numpy
from mvedge_jax.lightfield import LightField

from ._model import Renderer
from ._result import Optimised
from ._start import Start
from .approaches._approach import Approach
from .optimisation._optimise import Progress, optimise
from .optimisation._routine import Routine, all_at_once
from .optimisation._state import State, begin, resumed


@accepts_numpy
def optimize_edges(
    light_field: LightField,
    start: Start,
    approach: Approach,
    renderer: Renderer,
    *,
    routine: Routine | None = None,
    state: State | None = None,
    progress: Callable[[Progress], None] | None = None,
    key: PRNGKeyArray | None = None,
) -> Optimised:
    """Optimizes points and smoothness so that the rendered map explains the views.

    Runs on the host, in compiled pieces. Ground truth is not read.

    Args:
        light_field: the views.
        start: the initial model and the first map, see `start_from_depth`.
        approach: the objective: `ByEvidence()`, or `ByReprojection()` as in the thesis.
        renderer: renders the model to a map, such as `Renderer.on_raster(1)`.
        routine: learning rates of every iteration; by default `approach.iterations` on all
            parameters at once.
        state: state of an earlier call with the same arguments, to resume it: finished iterations
            of `routine` are skipped.
        progress: called after every quarter with a `Progress`.
        key: random key of `ByReprojection.subset`, fixed by default; nothing else is random.

    Returns:
        The map, the model with the lowest loss, the history and the verdict. Not differentiable,
        but its objective is.

    Raises:
        ValueError: `start` does not have the shape of the views, or `state` has another size.

    Source:
        Thesis 7.1.4 and 7.1.5. `ByEvidence` documents the differences.

    Example:
        >>> import jax.numpy as jnp
        >>> from mvedge_jax.model.approaches import ByReprojection
        >>> from mvedge_jax.model import DepthModel
        >>> flat = LightField(jnp.full((3, 3, 8, 8, 3), 0.5))  # views that have nothing to say
        >>> one, image = jnp.ones(1), jnp.zeros((8, 8))
        >>> model = DepthModel(0 * one, jnp.full((1, 2), 4.0), 0 * one, image, one > 0)
        >>> start, renderer = Start(model, 0.01 * one, image), Renderer.on_raster(1)
        >>> approach = ByReprojection(fit=None)  # the model of the start renders its map
        >>> found = optimize_edges(flat, start, approach, renderer)
        >>> bool(abs(found.disparity).max() < 1e-3)
        True
    """
    shape = light_field.views.shape[2:4]
    if start.disparity.shape != shape:
        raise ValueError(
            f"The map of `start` has the shape {start.disparity.shape}; the views have {shape}."
        )
    blind = light_field.bare()
    prepared = approach.prepare(blind, start, renderer)
    if routine is None:
        routine = all_at_once(approach.rates, iterations=approach.iterations)
    key = jax.random.key(0) if key is None else key
    begun = begin(prepared.start.model, prepared.start.disparity, key=key)
    final, history = optimise(resumed(begun, state), routine, prepared.objective, progress=progress)
    disparity, verdict = approach.finish(blind, prepared, final)
    return Optimised(disparity, final.best, history, final, verdict)
