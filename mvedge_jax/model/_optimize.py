"""Optimization of the model in one call: towards a known map, or against the views."""

from collections.abc import Callable

import equinox as eqx
import jax
from jaxtyping import PRNGKeyArray

from mvedge_jax._params import accepts_numpy
from mvedge_jax.lightfield import GroundTruth, LightField
from mvedge_jax.losses import SupervisedWeights

from ._host import compiled_render
from ._model import Renderer, without_free_places
from ._result import Optimized
from ._start import Start
from .approaches._approach import Approach
from .objectives import Supervised, unlimited
from .optimization._grow import Growth
from .optimization._optimize import Progress, Strategy, optimize
from .optimization._routine import Rates, Routine, all_at_once
from .optimization._state import State, begin, resumed


class SupervisedFit(eqx.Module):
    """Weights, rates and length of a supervised optimization.

    Attributes:
        weights: of the terms of the loss.
        rates: learning rates.
        iterations: default number of iterations.
    """

    weights: SupervisedWeights = eqx.field(default_factory=SupervisedWeights)
    rates: Rates = eqx.field(default_factory=Rates.supervised)
    iterations: int = eqx.field(static=True, default=40)


@accepts_numpy
def fit_edges(
    truth: GroundTruth,
    start: Start,
    fit: SupervisedFit,
    renderer: Renderer,
    *,
    strategy: Strategy | None = None,
    routine: Routine | None = None,
    state: State | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Optimized:
    """Fits points and smoothness to a known map, to measure what the model can represent.

    Runs on the host, in compiled pieces, deterministically.

    Args:
        truth: the map, px per view step, and a mask of known pixels.
        start: the initial model, see `start_from_depth`, and a map near its rendering; the errors
            of its labels are not used. Free slots are dropped.
        fit: see `SupervisedFit`.
        renderer: renders the model to a map, such as `Renderer.on_raster(1)`.
        strategy: adds or moves points; by default `Growth()`. `FixedPoints()` only follows
            gradients, as in the thesis.
        routine: learning rates of every iteration; by default `fit.iterations` on all parameters
            at once.
        state: state of an earlier call with the same arguments, to resume it: finished iterations
            of `routine` are skipped.
        progress: called between pieces with a `Progress`.

    Returns:
        The map, the model with the lowest loss, the history. Not differentiable: each iteration
        is a step along the gradient of `Supervised`, which is.

    Raises:
        ValueError: the shapes of `truth` and `start` differ, or `state` is of another size.

    Source: Thesis 7.1.4, 7.1.5 and 7.2.3; points are moved as named in 8.1.1.

    Example:
        >>> import jax.numpy as jnp
        >>> from mvedge_jax.model import DepthModel
        >>> from mvedge_jax.model.optimization import FixedPoints
        >>> one, image = jnp.ones(1), jnp.zeros((6, 8))
        >>> middle = DepthModel(0 * one, jnp.array([[4.0, 3.0]]), 0 * one, image, one > 0)
        >>> truth = GroundTruth(image + 0.1, image == 0)  # the point says 0, but 0.1 is true
        >>> start, renderer = Start(middle, one, image), Renderer.on_raster(1)
        >>> found = fit_edges(truth, start, SupervisedFit(), renderer, strategy=FixedPoints())
        >>> bool(abs(found.disparity - 0.1).max() < 0.01)
        True
    """
    if truth.disparity.shape != start.disparity.shape:
        raise ValueError(
            f"`truth` has the shape {truth.disparity.shape}; the map of `start` has "
            f"{start.disparity.shape}."
        )
    strategy = Growth() if strategy is None else strategy
    model = strategy.prepare(without_free_places(start.model))
    known = truth.disparity.astype(model.disparity.dtype)
    goal = Supervised(known, truth.valid, unlimited(model), renderer, fit.weights)
    if routine is None:
        routine = all_at_once(fit.rates, iterations=fit.iterations)
    begun = resumed(begin(model, start.disparity, key=jax.random.key(0)), state)
    final, history = optimize(begun, routine, goal, strategy=strategy, progress=progress)
    best = compiled_render(final.best, renderer, start=final.disparity)
    return Optimized(best.disparity, final.best, history, final)


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
) -> Optimized:
    """Optimizes points and smoothness so that the rendered map explains the views.

    Runs on the host, in compiled pieces. Ground truth is not read.

    Args:
        light_field: the views.
        start: the initial model and the first map, see `start_from_depth`.
        approach: the objective: `ByEvidence()`, or `ByReprojection()` as in the thesis.
        renderer: renders the model to a map, such as `Renderer.on_raster(1)`.
        routine: as for `fit_edges`, with `approach.iterations`.
        state: as for `fit_edges`.
        progress: called after every quarter with a `Progress`.
        key: random key of `ByReprojection.subset`, fixed by default; nothing else is random.

    Returns:
        The map, the model with the lowest loss, the history and the verdict. Not differentiable,
        but its objective is.

    Raises:
        ValueError: `start` does not have the shape of the views, or `state` has another size.

    Source: Thesis 7.1.4 and 7.1.5. `ByEvidence` documents the differences.

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
    final, history = optimize(resumed(begun, state), routine, prepared.objective, progress=progress)
    disparity, verdict = approach.finish(blind, prepared, final)
    return Optimized(disparity, final.best, history, final, verdict)
