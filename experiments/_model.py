"""What the experiments on the differentiable model share: scenes, starts, runs, scores."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mvedge_jax.datasets import load_light_field, synthetic
from mvedge_jax.lightfield import LightField
from mvedge_jax.losses import (
    LossWeights,
    SupervisedWeights,
    all_views,
    gather_views,
    self_supervised_loss,
)
from mvedge_jax.metrics import depth_scores
from mvedge_jax.reconstruct import (
    DepthModel,
    GrowParams,
    History,
    ModelParams,
    ModelSizes,
    Parameters,
    PolishParams,
    Rates,
    RefineParams,
    SelfSupervised,
    Sizes,
    Start,
    StartParams,
    State,
    Supervised,
    advance,
    all_at_once,
    begin,
    edge_to_depth,
    finish_refinement,
    fit_to_map,
    image_roughness,
    optimise,
    optimise_growing,
    polish,
    prepare_refinement,
    render_model,
    start_from_points,
    trust_labels,
    unlimited,
    with_capacity,
    without_free_places,
)
from mvedge_jax.splatting import SplatSizes


def rendering(raster: int) -> tuple[ModelParams, ModelSizes]:
    """Parameters and sizes for 1 or 2 raster pixels per pixel."""
    return ModelParams.narrow(raster), ModelSizes(splat=SplatSizes(scale=raster))


def load_scene(name: str, data: Path | None, *, size: int = 128) -> LightField:
    """A scene of the development data (`hci/cotton`), or a synthetic one by name and size."""
    if name in synthetic.scene_names():
        return synthetic.render(
            synthetic.scene(name), shape=(9, 9, size, size), key=jax.random.key(0)
        )
    if data is None:
        raise FileNotFoundError(f"{name!r} needs the development data; pass --data FOLDER.")
    return load_light_field(data / name)


def first_map(light_field: LightField) -> tuple[Start, jax.Array]:
    """Edge points as a model, and the map of `edge_to_depth`."""
    blind = light_field.without_truth()
    result = edge_to_depth(Parameters(), blind, Sizes.for_light_field(blind))
    points = result.points
    start = start_from_points(
        points.xy + result.surface.offset,
        points.disparity,
        points.error,
        points.valid,
        blind.centre_view,
        result.disparity,
        StartParams(),
    )
    return start, result.disparity


def plain_model(start: Start, centre: jax.Array) -> DepthModel:
    """The thesis' start: equal weights, Q from the image gradient."""
    model = start.model
    rough = image_roughness(centre, jnp.asarray(0.3))
    return eqx.tree_at(
        lambda m: (m.log_weight, m.roughness), model, (jnp.zeros_like(model.log_weight), rough)
    )


def scores(disparity: jax.Array, light_field: LightField, *, crop: int = 0) -> dict[str, float]:
    """The table's columns; empty without ground truth."""
    truth = light_field.truth
    if truth is None:
        return {}
    found = depth_scores(disparity, truth.disparity, mask=truth.valid, crop=crop)
    row = {k: float(v) for k, v in found._asdict().items()}
    return {k: row[k] for k in ("mse", "q25", "bad_01", "bad_03", "bad_07")}


Look = Callable[[int, jax.Array, float], None]


def run_supervised(
    model: DepthModel,
    light_field: LightField,
    *,
    raster: int,
    iterations: int,
    recycle: bool = False,
    extra: int = 0,
    look: Look | None = None,
) -> tuple[DepthModel, jax.Array]:
    """Fits a model to the ground truth, all parameters at once.

    With `recycle`, points that do nothing move to where the map is wrong; `extra` points are
    added there.
    """
    truth = light_field.truth
    if truth is None:
        raise ValueError(f"{light_field.name} has no ground truth.")
    params, sizes = rendering(raster)
    model = without_free_places(model)
    model = with_capacity(model, model.valid.size + extra)
    known = truth.disparity.astype(model.disparity.dtype)
    weights = SupervisedWeights(square=jnp.asarray(3.0))
    goal = Supervised(known, truth.valid, unlimited(model), params, weights, sizes)
    table = all_at_once(Rates.supervised(), iterations=iterations)
    state = begin(model, jnp.zeros_like(known), key=jax.random.key(0))

    def after_chunk(state: State, history: History) -> None:
        if look is not None:
            look(int(state.iteration), state.disparity, float(history.loss[-1]))

    if recycle or extra:
        growth = GrowParams() if recycle else GrowParams(least=jnp.asarray(0.0))
        state, _ = optimise_growing(state, table, goal, growth, after_chunk=after_chunk)
    else:
        state, _ = optimise(state, table, goal, chunk=10, after_chunk=after_chunk)
    best = eqx.filter_jit(render_model)(state.best, params, sizes, start=state.disparity)
    return state.best, best.disparity


def run_refined(
    start: Start,
    light_field: LightField,
    first: jax.Array,
    *,
    raster: int,
    iterations: int,
    refine: RefineParams | None = None,
    look: Look | None = None,
) -> jax.Array:
    """What `mvedge optimize` does: the evidence of all views, confirmed by halves of them."""
    params, sizes = rendering(raster)
    blind = light_field.without_truth()
    views = gather_views(blind, choice=all_views(blind))
    refine = RefineParams() if refine is None else refine
    refinement = prepare_refinement(start, first, views, refine, params, sizes)
    table = all_at_once(Rates.evidence(), iterations=iterations)
    state = begin(refinement.start.model, refinement.rendered, key=jax.random.key(0))
    piece = max(iterations // 4, 1)
    for at in range(0, iterations, piece):
        state, history = advance(state, table.part(at, at + piece), refinement.objective)
        if look is not None:
            look(int(state.iteration), state.disparity, float(history.loss[-1]))
    print(f"share of proposals confirmed: {float(refinement.correction.share.mean()):.3f}")
    return finish_refinement(refinement, state.best, refine)


def run_self_supervised(
    start: Start,
    light_field: LightField,
    first: jax.Array,
    *,
    raster: int,
    iterations: int,
    fit: bool = True,
    prior: float = 1e-3,
    label: float = 0.05,
    look: Look | None = None,
) -> tuple[Start, jax.Array]:
    """Minimises the reprojection error, with trust in the labels' errors, and polishes."""
    params, sizes = rendering(raster)
    views = gather_views(light_field.without_truth())
    count = views.steps.shape[0]
    training, held_out = (views.take(jnp.arange(offset, count, 2)) for offset in (0, 1))
    if fit:
        extra = int(np.asarray(start.model.valid).sum()) // 10
        start = fit_to_map(start, first, StartParams(), params, sizes, extra=extra)
    trust = trust_labels(start, weight=prior, label=label)
    goal = SelfSupervised(training, trust, params, LossWeights(), sizes=sizes)
    rates = Rates.self_supervised()
    if not fit:
        rates = Rates(rates.rate.at[1].set(0.01))
    table = all_at_once(rates, iterations=iterations)
    state = begin(start.model, first, key=jax.random.key(0))
    piece = max(iterations // 4, 1)
    for at in range(0, iterations, piece):
        state, history = advance(state, table.part(at, at + piece), goal)
        if look is not None:
            look(int(state.iteration), state.disparity, float(history.loss[-1]))
    render = eqx.filter_jit(render_model)
    after = render(state.best, params, sizes, start=state.disparity).disparity
    if fit:
        # The model's own error in rendering the first map does not enter, only what changed.
        after = first + after - render(start.model, params, sizes, start=first).disparity
        explains = eqx.filter_jit(self_supervised_loss)
        error = [
            float(explains(d, held_out, LossWeights())[1].reprojection) for d in (first, after)
        ]
        print(f"held-out error {error[0]:.6f} -> {error[1]:.6f}", flush=True)
        # As `mvedge optimize --loss reprojection` does: smaller gains are no evidence.
        after = after if error[1] < 0.9 * error[0] else first
    return Start(state.best, start.error), polish(after, PolishParams())


def printer(name: str, light_field: LightField, rows: list[dict[str, Any]]) -> Look:
    """A `look` that records and prints a row per piece."""

    def look(iteration: int, disparity: jax.Array, loss: float) -> None:
        row = {"run": name, "iteration": iteration, "loss": loss, **scores(disparity, light_field)}
        rows.append(row)
        print({k: v if isinstance(v, str) else round(v, 5) for k, v in row.items()}, flush=True)

    return look
