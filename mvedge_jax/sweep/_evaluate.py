"""Scores of several settings on one light field, by one program."""

import functools
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mvedge_jax._batched import batched
from mvedge_jax._compiler import lean_jit
from mvedge_jax._settings import Setting, with_settings
from mvedge_jax.datasets import load_light_field
from mvedge_jax.depth import DepthResult, EdgeDepth, estimate_depth
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import DepthScores, depth_scores

Objective = str | Callable[[DepthResult, LightField], Float[Array, ""]]


def check_objective(objective: Objective) -> None:
    """Raises a ValueError if a name is not that of a depth score."""
    if isinstance(objective, str) and objective not in DepthScores._fields:
        raise ValueError(
            f"`objective` must be one of {DepthScores._fields} or a function, got {objective!r}."
        )


def _score(objective: Objective, result: DepthResult, light_field: LightField) -> Array:
    if not isinstance(objective, str):
        return objective(result, light_field)
    truth = light_field.truth
    assert truth is not None, "`evaluate` asks for it"
    return getattr(
        depth_scores(result.disparity, truth.disparity, mask=truth.valid), objective
    ).astype(result.disparity.dtype)


@lean_jit
def _scores(
    rows: Float[Array, "b k"],
    model: EdgeDepth,
    light_field: LightField,
    names: tuple[str, ...],
    objective: Objective,
) -> Float[Array, " b"]:
    def one(row: Float[Array, " k"], model: EdgeDepth, light_field: LightField) -> Array:
        varied = model.replace({name: row[i] for i, name in enumerate(names)})
        # Random parts use the same key for every setting.
        found = estimate_depth(light_field.without_truth(), varied, key=jax.random.key(0))
        return _score(objective, found, light_field)

    return batched(one)(rows, model, light_field)


def _model(
    light_field: LightField, preset: str, choices: tuple[tuple[str, Setting], ...]
) -> EdgeDepth:
    blind = light_field.without_truth()
    model = EdgeDepth.for_light_field(blind, preset=preset)  # pyright: ignore
    return with_settings(model, dict(choices))


@functools.lru_cache(maxsize=8)
def _read(
    path: Path, preset: str, choices: tuple[tuple[str, Setting], ...]
) -> tuple[LightField, EdgeDepth]:
    light_field = load_light_field(path)
    return light_field, _model(light_field, preset, choices)


def evaluate(
    scene: str | Path | LightField,
    rows: Float[np.ndarray, "b k"],
    *,
    names: tuple[str, ...],
    choices: dict[str, Setting],
    preset: str,
    objective: Objective,
    batch: int,
) -> Float[np.ndarray, " b"]:
    """Scores settings on one scene: the task of a worker of a sweep.

    Args:
        scene: a light field, or the path of one, which is cached for the next call.
        rows: values of the numbers at `names`, one setting a row.
        names: paths of the numbers.
        choices: other numbers and static fields of the model, by path.
        preset: see `EdgeDepth.for_light_field`.
        objective: a field of `DepthScores`, or a jittable function of result and light field.
        batch: settings per call of the program; smaller batches are padded, to compile once.

    Returns:
        One score per row; the smaller, the better.

    Raises:
        ValueError: the objective is unknown, or needs a ground truth that the scene lacks.
    """
    check_objective(objective)
    chosen = tuple(sorted(choices.items()))
    if isinstance(scene, LightField):
        light_field, model = scene, _model(scene, preset, chosen)
    else:
        light_field, model = _read(Path(scene), preset, chosen)
    if isinstance(objective, str) and light_field.truth is None:
        raise ValueError(
            f"scene {light_field.name} has no ground truth; give a function as `objective`."
        )
    # Scenes of one kind share a program.
    dtype, light_field = light_field.views.dtype, light_field.renamed("")
    scores = []
    for start in range(0, len(rows), batch):
        part = rows[start : start + batch]
        filled = np.concatenate([part, np.repeat(part[-1:], batch - len(part), axis=0)])
        found = _scores(jnp.asarray(filled, dtype), model, light_field, names, objective)
        scores.append(np.asarray(found)[: len(part)])
    return np.concatenate(scores) if scores else np.zeros(0)
