"""`mvedge optimize`: fit the differentiable multi-view edge model to the views."""

import time
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import numpy as np
import tyro
from matplotlib.figure import Figure

from mvedge_jax import plotting
from mvedge_jax.datasets import write_pfm
from mvedge_jax.depth import EdgeDepth, estimate_depth
from mvedge_jax.lightfield import GroundTruth, LightField
from mvedge_jax.losses.features import Colors, FilterBank, load_vgg16
from mvedge_jax.losses.terms import Features
from mvedge_jax.metrics import depth_scores
from mvedge_jax.model import (
    Optimized,
    Renderer,
    Start,
    SupervisedFit,
    fit_edges,
    optimize_edges,
    start_from_depth,
    start_from_edges,
    start_from_image,
)
from mvedge_jax.model.approaches import Approach, ByEvidence, ByReprojection
from mvedge_jax.model.optimization import (
    Growth,
    History,
    Progress,
    Rates,
    Routine,
    State,
    all_at_once,
    one_at_a_time,
)

from ._common import compiled, missing_views, note, score_line, stage, warn
from ._model import FULL, ModelArg, ModelOptions
from ._output import output_folder, write_csv, write_json
from ._source import read_scene


def optimize(
    scene: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    /,
    *,
    supervised: bool = False,
    loss: Literal["evidence", "reprojection", "printed"] = "evidence",
    routine: Literal["joint", "thesis"] | None = None,
    iterations: int | None = None,
    features: Literal["colors", "filters", "vgg16"] = "colors",
    vgg16: Path | None = None,
    no_recycle: bool = False,
    grow_points: int = 0,
    subset: int | None = None,
    raster: Literal[1, 2] | None = None,
    views: int | None = None,
    scale: float = 1.0,
    state: Path | None = None,
    seed: int = 0,
    overwrite: bool = False,
    options: ModelArg = FULL,
) -> None:
    """Optimizes points and smoothness so that the rendered map explains the views.

    Starts from the points and the map of `mvedge depth`. `--loss evidence` linearizes the
    photometric error of all views around that map, with gloss and shading eliminated; a correction
    by one half of the views is accepted as far as the other half confirms it. `--loss
    reprojection`, (7.15) of the thesis, holds every second view of the crosshair out and drops a
    result that does not lower their error by a tenth. The map is polished (bends within its error
    are removed). `--loss printed` is Chapter 7 to the letter: points of weight 1 and no dense map,
    all views of the crosshair, the thesis' routine and renderer; nothing is dropped or polished.
    `--preset thesis` gives it the points of Chapter 4. OUT gets before.pfm, disparity.pfm,
    pictures, points.npz, loss.csv, loss.png, state.eqx and report.json.

    Args:
        scene: folder or file of a light field; `mvedge info` checks it.
        out: folder to write.
        supervised: fit to the scene's ground truth instead of the views.
        loss: the objective, see above.
        routine: all parameters at once (joint), or the thesis' turns (Q, Z, R, xy; 5 passes), the
            default of `--loss printed`.
        iterations: total number for `joint`, by default 12 for the evidence and 40 otherwise; per
            parameter and pass for `thesis`, by default 13 as in the thesis.
        features: image features to compare, for `--loss reprojection` and `printed`.
        vgg16: an .npz file of VGG16's first two convolutions, for `--features vgg16`.
        no_recycle: with `--supervised`, do not relocate inactive points to pixels of large error.
        grow_points: number of points to add at pixels of large error; needs `--supervised`.
        subset: number of views drawn per iteration of `--loss reprojection`; all by default.
        raster: raster pixels per pixel and axis, of narrow points; by default 1. For `--loss
            printed`, by default the thesis' wide points on a raster of 2, which takes four times as
            long.
        views: use the central VIEWS x VIEWS views only; odd.
        scale: shrink the views by this factor, at most 1.
        state: state.eqx of an earlier run with the same options, to resume it.
        seed: seed of random views, and of the random search of preset thesis.
        overwrite: replace OUT if it is a result of mvedge without other files in it.
        options: options of the model of the first map.
    """
    options.check()
    growth = Growth(recycle=not no_recycle, extra=_at_least(0, "--grow-points", grow_points))
    if grow_points and not supervised:
        raise ValueError("--grow-points needs --supervised: without truth no residual is known.")
    approach, fit = _approach(loss, features, vgg16, subset), SupervisedFit()
    printed = loss == "printed"
    if printed and supervised:
        raise ValueError("--loss printed reads views alone; leave out --supervised or --loss.")
    wide = printed and raster is None
    renderer = Renderer.thesis() if wide else Renderer.on_raster(raster or 1)
    routine = routine or ("thesis" if printed else "joint")
    table = _table(routine, iterations, fit if supervised else approach)
    light_field, said = _read(scene, views, scale, needs_truth=supervised)
    earlier = None if state is None else State.load(state)
    running: dict[str, Any] = {"routine": table, "state": earlier, "progress": _tell}
    inputs = [path for path in (scene, vgg16, state) if path is not None]
    with output_folder(out, inputs=inputs, overwrite=overwrite) as folder:
        alone = renderer if printed else None
        start, model, doubts = _start(light_field.without_truth(), options, seed, alone)
        clock = time.perf_counter()
        with stage("optimizing"):
            if supervised and light_field.truth is not None:
                start = start_from_image(start, light_field.center_view)
                goal = light_field.truth
                result = fit_edges(goal, start, fit, renderer, strategy=growth, **running)
            else:
                key = jax.random.key(seed)
                result = optimize_edges(light_field, start, approach, renderer, key=key, **running)
        seconds = time.perf_counter() - clock
        doubts = [*said, *doubts, *missing_views(light_field), *_doubts(result)]
        told = options.described(model) | {"seed": seed, "warnings": doubts}
        scores = _write(folder, light_field, start, result, seconds, told)
    for doubt in doubts:
        warn(doubt)
    _conclude(scores, result, seconds, out)


def _at_least(least: int, name: str, value: int) -> int:
    if value < least:
        wish = "not be negative" if least == 0 else f"be at least {least}"
        raise ValueError(f"{name} must {wish}, got {value}.")
    return value


def _approach(
    loss: str, features: str, vgg16: Path | None, subset: int | None
) -> ByEvidence | ByReprojection:
    extractor: Features = FilterBank() if features == "filters" else Colors()
    if features == "vgg16":
        if vgg16 is None:
            raise ValueError("--features vgg16 needs --vgg16 FILE, an .npz file of its weights.")
        extractor = load_vgg16(vgg16)
    if loss == "printed":
        return ByReprojection.thesis(extractor, subset=subset)
    if loss == "reprojection":
        return ByReprojection(features=extractor, subset=subset)
    return ByEvidence(features=extractor)


def _table(routine: str, iterations: int | None, params: SupervisedFit | Approach) -> Routine:
    if iterations is not None:
        _at_least(1, "--iterations", iterations)
    if routine == "thesis":
        return one_at_a_time(Rates(), **({} if iterations is None else {"iterations": iterations}))
    return all_at_once(params.rates, iterations=iterations or params.iterations)


def _read(
    scene: Path, views: int | None, scale: float, *, needs_truth: bool
) -> tuple[LightField, list[str]]:
    """The light field, and warnings of its reader."""
    with stage(f"reading {scene}"):
        light_field, said = read_scene(scene, views=views, scale=scale)
    if needs_truth and light_field.truth is None:
        raise ValueError(f"{scene} has no ground truth, which --supervised needs.")
    return light_field, said


def _start(
    blind: LightField, options: ModelOptions, seed: int, alone: Renderer | None
) -> tuple[Start, EdgeDepth, list[str]]:
    """The start, its model, and its problems; `alone` renders the points without a dense map."""
    with stage("estimating depth from edges"):
        model, key = options.model(blind), jax.random.key(seed)
        program = compiled(estimate_depth, blind, model, key=key)
        result = jax.block_until_ready(program(blind, model, key=key))
        if alone is None:
            start = start_from_depth(blind, result)
        else:
            start = start_from_edges(blind, result, alone)
        return start, model, list(result.problems())


def _tell(now: Progress) -> None:
    note(f"  {now.iteration}/{now.iterations} loss {now.loss:.6f}")
    if now.grown is not None:
        moved, added = int(now.grown.recycled), int(now.grown.added) - int(now.grown.recycled)
        note(f"  {moved} points moved to where the map was wrong, {added} added")


def _write(
    folder: Path,
    light_field: LightField,
    start: Start,
    result: Optimized,
    seconds: float,
    told: dict[str, Any],
) -> dict[str, Any]:
    """Writes all files, the report with what is `told`, and returns the scores of the maps."""
    model, verdict = result.model, result.verdict
    write_pfm(folder / "before.pfm", np.asarray(start.disparity))
    write_pfm(folder / "disparity.pfm", np.asarray(result.disparity))
    result.state.save(folder / "state.eqx")
    keep = np.asarray(model.valid)
    np.savez_compressed(
        folder / "points.npz",
        xy=np.asarray(model.xy)[keep],
        disparity=np.asarray(model.disparity)[keep],
        weight=np.exp(-np.asarray(model.log_weight))[keep],
        roughness=np.asarray(model.roughness),
    )
    _write_history(folder, result.history)
    maps = {"before": start.disparity, "after": result.disparity}
    scores = _write_pictures(folder, maps, light_field.truth)
    confirmed = None if verdict is None else verdict.confirmed
    report = {
        "scene": light_field.name,
        "supervised": verdict is None,
        "iterations": int(result.state.iteration),
        "seconds": round(seconds, 2),
        "points": int(keep.sum()),
        "reprojection error before, after": [] if verdict is None else verdict.error.tolist(),
        "share of proposals confirmed": None if confirmed is None else float(confirmed),
        "kept the optimized points": verdict is None or bool(verdict.kept),
        "scores": scores,
        **told,
    }
    write_json(folder / "report.json", report)
    return scores


def _write_history(folder: Path, history: History) -> None:
    losses, gradient = (np.asarray(part) for part in history)
    rows = ([i, loss, *norms] for i, (loss, norms) in enumerate(zip(losses, gradient, strict=True)))
    header = ["iteration", "loss", "grad_Q", "grad_Z", "grad_R", "grad_xy"]
    write_csv(folder / "loss.csv", header, rows)
    figure = Figure(layout="constrained")
    axes = figure.subplots()
    axes.plot(losses)
    axes.set_xlabel("iteration")
    axes.set_ylabel("loss")
    figure.savefig(folder / "loss.png")


def _write_pictures(
    folder: Path, maps: dict[str, jax.Array], truth: GroundTruth | None
) -> dict[str, Any]:
    """Maps in color and, if there is ground truth, their errors and scores."""
    scores = {}
    for name, disparity in maps.items():
        plotting.plot_disparity(np.asarray(disparity)).savefig(folder / f"{name}.png")
        if truth is not None:
            known = np.where(np.asarray(truth.valid), np.asarray(truth.disparity), np.nan)
            plotting.plot_error(np.asarray(disparity), known, kind="log").savefig(
                folder / f"{name}_error.png"
            )
            found = depth_scores(disparity, truth.disparity, mask=truth.valid)
            scores[name] = {column: float(value) for column, value in found._asdict().items()}
    return scores


def _doubts(result: Optimized) -> list[str]:
    doubts, losses = [], np.asarray(result.history.loss)
    if result.verdict is not None and not bool(result.verdict.kept):
        doubts.append(
            "the held-out views do not speak for the optimized points; the first map was polished."
        )
    if not np.isfinite(losses).all():
        count = int((~np.isfinite(losses)).sum())
        doubts.append(f"{count} of {losses.size} iterations had no finite loss and were skipped.")
    if not np.isfinite(np.asarray(result.disparity)).all():
        doubts.append("the map is not finite everywhere.")
    return doubts


def _conclude(scores: dict[str, Any], result: Optimized, seconds: float, out: Path) -> None:
    for name, row in scores.items():
        note(score_line(name, row))
    note(f"{len(result.history.loss)} iterations, {seconds:.1f} s; written to {out}")
