"""What the experiments on the differentiable model share: starts, runs, scores."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from mvedge_jax.depth import EdgeDepth
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import depth_scores
from mvedge_jax.model import (
    Renderer,
    Start,
    SupervisedFit,
    fit_edges,
    optimize_edges,
    start_from_depth,
    start_from_image,
)
from mvedge_jax.model.approaches import Approach, ByEvidence
from mvedge_jax.model.optimization import FixedPoints, Progress, Strategy, all_at_once


def first_map(light_field: LightField) -> Start:
    """Edge points as a model, and the map of `EdgeDepth`."""
    blind = light_field.without_truth()
    return start_from_depth(blind, EdgeDepth.for_light_field(blind)(blind))


def plain(start: Start, center: jax.Array) -> Start:
    """The thesis' start: equal weights, Q from the image gradient."""
    start = start_from_image(start, center)
    equal = jnp.zeros_like(start.model.log_weight)
    return start._replace(model=eqx.tree_at(lambda m: m.log_weight, start.model, equal))


def scores(disparity: jax.Array, light_field: LightField, *, crop: int = 0) -> dict[str, float]:
    """The table's columns; empty without ground truth."""
    truth = light_field.truth
    if truth is None:
        return {}
    found = depth_scores(disparity, truth.disparity, mask=truth.valid, crop=crop)
    row = {k: float(v) for k, v in found._asdict().items()}
    return {k: row[k] for k in ("mse", "q25", "bad_01", "bad_03", "bad_07")}


Look = Callable[[Progress], None]


def run_supervised(
    start: Start,
    light_field: LightField,
    *,
    raster: int,
    iterations: int,
    strategy: Strategy | None = None,
    look: Look | None = None,
) -> jax.Array:
    """Fits a model to the ground truth; by default by gradients alone, in pieces of ten."""
    truth = light_field.truth
    if truth is None:
        raise ValueError(f"{light_field.name} has no ground truth.")
    fit, strategy = SupervisedFit(), FixedPoints(piece=10) if strategy is None else strategy
    table = all_at_once(fit.rates, iterations=iterations)
    return fit_edges(
        truth, start, fit, Renderer.on_raster(raster),
        strategy=strategy, routine=table, progress=look,
    ).disparity  # fmt: skip


def run_self_supervised(
    start: Start,
    light_field: LightField,
    *,
    raster: int,
    iterations: int,
    approach: Approach | None = None,
    look: Look | None = None,
) -> jax.Array:
    """What `mvedge optimize` does, and prints what the views say of it."""
    approach = ByEvidence() if approach is None else approach
    table = all_at_once(approach.rates, iterations=iterations)
    renderer = Renderer.on_raster(raster)
    found = optimize_edges(light_field, start, approach, renderer, routine=table, progress=look)
    if found.verdict is not None:
        before, after = found.verdict.error.tolist()
        print(f"held-out error {before:.6f} -> {after:.6f}", flush=True)
        if found.verdict.confirmed is not None:
            print(f"share of proposals confirmed: {float(found.verdict.confirmed):.3f}")
    return found.disparity


def printer(name: str, light_field: LightField, rows: list[dict[str, Any]]) -> Look:
    """A `look` that records and prints a row per piece."""

    def look(now: Progress) -> None:
        found = scores(now.state.disparity, light_field)
        row = {"run": name, "iteration": now.iteration, "loss": now.loss, **found}
        rows.append(row)
        print({k: v if isinstance(v, str) else round(v, 5) for k, v in row.items()}, flush=True)

    return look
