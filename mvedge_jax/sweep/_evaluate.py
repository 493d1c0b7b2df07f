"""Scores of several settings on one light field, by one program."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mvedge_jax._compiler import lean_jit
from mvedge_jax.datasets import load_light_field
from mvedge_jax.depth import DepthResult, Parameters, Sizes, edge_to_depth
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import DepthScores, depth_scores

from ._space import with_numbers

Objective = str | Callable[[DepthResult, LightField], Float[Array, ""]]


def check_objective(objective: Objective) -> None:
    """Raises where a name is not that of a depth score."""
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
    params: Parameters,
    light_field: LightField,
    sizes: Sizes,
    names: tuple[str, ...],
    objective: Objective,
) -> Float[Array, " b"]:
    blind = light_field.without_truth()

    def one(row: Float[Array, " k"]) -> Float[Array, ""]:
        found = edge_to_depth(blind, with_numbers(params, names, row), sizes)
        return _score(objective, found, light_field)

    # What no varied number reaches is computed once for all settings.
    return jax.vmap(one)(rows)


@functools.lru_cache(maxsize=8)
def _read(path: Path, choices: tuple[tuple[str, Any], ...]) -> tuple[LightField, Sizes]:
    light_field = load_light_field(path)
    return light_field, Sizes.for_light_field(light_field.without_truth(), **dict(choices))


def evaluate(
    scene: str | Path | LightField,
    rows: Float[np.ndarray, "b k"],
    params: Parameters,
    *,
    names: tuple[str, ...],
    choices: dict[str, Any],
    objective: Objective,
    batch: int,
) -> Float[np.ndarray, " b"]:
    """Scores settings on one scene: what a worker of a sweep does.

    Args:
        scene: a light field, or the path of one, which is then kept for the next call.
        rows: values of the numbers at `names`, one setting a row.
        params: everything else.
        names: paths of the numbers.
        choices: fields of `Sizes` set by hand.
        objective: the name of a field of `DepthScores`, or a jittable function of the result and
            the light field.
        batch: settings per call of the program; fewer are filled up, so that it is compiled once.

    Returns:
        One score per row; the smaller, the better.

    Raises:
        ValueError: the objective is unknown, or needs a ground truth that the scene lacks.
    """
    check_objective(objective)
    if isinstance(scene, LightField):
        sizes = Sizes.for_light_field(scene.without_truth(), **choices)
        light_field = scene
    else:
        light_field, sizes = _read(Path(scene), tuple(sorted(choices.items())))
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
        found = _scores(jnp.asarray(filled, dtype), params, light_field, sizes, names, objective)
        scores.append(np.asarray(found)[: len(part)])
    return np.concatenate(scores) if scores else np.zeros(0)
