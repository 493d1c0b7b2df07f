"""Gauss-Newton against Adam: loss over iterations and over seconds, from the same start.

Three objectives: the known map (`fit_edges`), what all views hold against the first map
(`ByEvidence`), and the reprojection error of half of the crosshair (`ByReprojection`). Adam has
the rates and the schedule of the package; Levenberg-Marquardt solves each step by conjugate
gradients through forward mode (`minimize_least_squares`). Seconds are without compilation.

    python experiments/second_order.py --out results/second_order
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import tyro
from _model import first_map, plain
from _report import print_table, write_json
from _scenes import find_scene
from matplotlib.figure import Figure
from peers.least_squares import minimize_least_squares

from mvedge_jax.lightfield import LightField
from mvedge_jax.model import Renderer, SupervisedFit
from mvedge_jax.model.approaches import ByEvidence, ByReprojection
from mvedge_jax.model.objectives import Supervised, unlimited
from mvedge_jax.model.optimization import (
    FixedPoints,
    Rates,
    all_at_once,
    begin,
    optimize,
)

# Below these errors, px, absolute ones are squares: corrections by the evidence are thousandths.
BLUNT = {"supervised": 0.01, "evidence": 0.001, "reprojection": 0.01}
# What is typical of changes of Q, Z, R and xy: labels of `EdgeDepth` are near their place.
SCALES = {
    "supervised": (1.0, 0.1, 1.0, 0.2),
    "evidence": (1.0, 0.01, 1.0, 0.2),
    "reprojection": (1.0, 0.1, 1.0, 0.2),
}


@dataclass(frozen=True)
class Arguments:
    """Options.

    Attributes:
        scene: rendered scene.
        size: side of the views, px.
        iterations: of Adam.
        steps: of Levenberg-Marquardt.
        tolerance: to which its linear systems are solved.
        objectives: which of the three.
        out: folder for the table and the curves.
    """

    scene: str = "demo"
    size: int = 64
    iterations: int = 150
    steps: int = 20
    tolerance: float = 0.1
    objectives: tuple[str, ...] = ("supervised", "evidence", "reprojection")
    out: Path = Path("results/second_order")


def objective(kind: str, light_field: LightField) -> tuple[Any, Any, jax.Array, Rates]:
    """Start, objective, a first map and the rates of Adam."""
    start, renderer = first_map(light_field), Renderer.on_raster(1)
    if kind == "supervised":
        start, truth = plain(start, light_field.center_view), light_field.truth
        assert truth is not None
        fit = SupervisedFit()
        goal = Supervised(
            truth.disparity, truth.valid, unlimited(start.model), renderer, fit.weights
        )
        return start.model, goal, start.disparity, fit.rates
    approach = {"evidence": ByEvidence(), "reprojection": ByReprojection()}[kind]
    prepared = approach.prepare(light_field.without_truth(), start, renderer)
    return prepared.start.model, prepared.objective, prepared.start.disparity, approach.rates


def adam(
    model: Any, goal: Any, first: jax.Array, rates: Rates, iterations: int
) -> tuple[list[float], float]:
    """Losses before every iteration, and warm seconds of all."""
    routine = all_at_once(rates, iterations=iterations)
    whole, state = FixedPoints(piece=iterations), begin(model, first, key=jax.random.key(0))
    optimize(state, routine, goal, strategy=whole)
    before = time.perf_counter()
    _, history = optimize(state, routine, goal, strategy=whole)
    losses = history.loss.tolist()
    return losses, time.perf_counter() - before


def newton(
    model: Any, goal: Any, first: jax.Array, kind: str, arguments: Arguments
) -> tuple[list[float], list[float]]:
    """Losses before the first step and after every one, and seconds at each of them."""
    moments = []
    found = minimize_least_squares(
        model,
        goal,
        first,
        steps=arguments.steps,
        scales=SCALES[kind],
        blunt=BLUNT[kind],
        tolerance=arguments.tolerance,
        progress=lambda step, loss: moments.append(time.perf_counter()),
    )
    # The first step is compiled: it is given the mean of the others.
    between = [after - before for before, after in zip(moments, moments[1:], strict=False)]
    first_step = sum(between) / max(len(between), 1)
    seconds, total = [0.0], 0.0
    for step in [first_step, *between]:
        total += step
        seconds.append(total)
    return found.loss.tolist(), seconds


def main() -> None:
    """Runs both on every objective and draws the curves."""
    arguments = tyro.cli(Arguments, description=__doc__)
    light_field = find_scene(arguments.scene, None, size=arguments.size)
    rows, curves = [], {}
    for kind in arguments.objectives:
        model, goal, first, rates = objective(kind, light_field)
        losses, spent = adam(model, goal, first, rates, arguments.iterations)
        steps, seconds = newton(model, goal, first, kind, arguments)
        target = min(losses)
        reached = next((k for k, loss in enumerate(steps) if loss <= target), None)
        curves[kind] = {"Adam": losses, "Adam s": spent, "Newton": steps, "Newton s": seconds}
        rows.append(
            {
                "objective": kind,
                "loss before": losses[0],
                f"Adam, {arguments.iterations}": target,
                "Adam s": spent,
                f"Newton, {len(steps) - 1}": min(steps),
                "Newton s": seconds[-1],
                "steps to Adam's": reached,
                "seconds to Adam's": None if reached is None else seconds[reached],
            }
        )
        print(rows[-1], flush=True)
        jax.clear_caches()
    print_table(rows, title=f"{arguments.scene}, {arguments.size} px")
    write_json(arguments.out / "second_order.json", {"rows": rows, "curves": curves})
    plot(curves).savefig(arguments.out / "second_order.png")


def plot(curves: dict[str, dict[str, Any]]) -> Figure:
    """Loss over iterations above, over seconds below."""
    figure = Figure(figsize=(4 * len(curves), 5.5), layout="constrained")
    axes = figure.subplots(2, len(curves), squeeze=False)
    for column, (kind, of) in enumerate(curves.items()):
        count = len(of["Adam"])
        per = jnp.linspace(0, of["Adam s"], count)
        for row, over in zip(axes[:, column], ("iterations", "seconds"), strict=True):
            row.semilogy(range(count) if over == "iterations" else per, of["Adam"], label="Adam")
            across = range(len(of["Newton"])) if over == "iterations" else of["Newton s"]
            row.semilogy(across, of["Newton"], "o-", markersize=3, label="Levenberg-Marquardt")
            row.set(xlabel=over, ylabel="loss", title=kind)
            row.legend()
    return figure


if __name__ == "__main__":
    main()
