"""`mvedge optimize`: fit the differentiable multi-view edge model to the views."""

import csv
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro
from matplotlib.figure import Figure

from .. import plotting
from ..datasets import load_light_field, write_pfm
from ..lightfield import LightField
from ..losses import (
    Colours,
    Features,
    FilterBank,
    LossWeights,
    SupervisedWeights,
    Views,
    all_views,
    gather_views,
    load_vgg16,
    self_supervised_loss,
)
from ..metrics import depth_scores
from ..reconstruct import (
    DepthModel,
    Grown,
    GrowParams,
    History,
    ModelParams,
    ModelSizes,
    Parameters,
    PolishParams,
    Rates,
    RefineParams,
    Routine,
    SelfSupervised,
    Sizes,
    Start,
    StartParams,
    State,
    Supervised,
    all_at_once,
    begin,
    edge_to_depth,
    finish_refinement,
    fit_to_map,
    image_roughness,
    load_state,
    one_at_a_time,
    optimise,
    optimise_growing,
    polish,
    prepare_refinement,
    render_model,
    save_state,
    start_from_points,
    trust_labels,
    unlimited,
    with_capacity,
    without_free_places,
)
from ..splatting import SplatSizes
from ._common import compiled, note, stage, warn
from ._output import output_folder, write_json

# On cotton the true map explains the views 0.7 % worse than that of `mvedge depth`, and every
# optimisation by plain reprojection that lowered the error by less than a tenth made the map
# worse: gloss, blurred image edges and bilinear interpolation have a say of that size.
_MARGIN = 0.1
_COLUMNS = {
    "mse": "MSE*100",
    "q25": "Q25*100",
    "bad_01": "BP(0.01) %",
    "bad_03": "BP(0.03) %",
    "bad_07": "BP(0.07) %",
}


def optimize(
    scene: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    /,
    *,
    supervised: bool = False,
    loss: Literal["evidence", "reprojection"] = "evidence",
    routine: Literal["joint", "thesis"] = "joint",
    iterations: int = 40,
    features: Literal["colours", "filters", "vgg16"] = "colours",
    vgg16: Path | None = None,
    recycle: bool = True,
    grow_points: int = 0,
    subset: int | None = None,
    raster: Literal[1, 2] = 1,
    views: int | None = None,
    scale: float = 1.0,
    state: Path | None = None,
    seed: int = 0,
    overwrite: bool = False,
) -> None:
    """Optimises points and smoothness so that the rendered map explains the views.

    Starts from the points and the map of `mvedge depth`. With `--loss evidence` the photometric
    error of all views is linearised around that map, freed from gloss and shading, and halved:
    what either half of the views proposes counts as far as the other half confirms it. With
    `--loss reprojection`, (7.15) of the thesis, every second view of the crosshair is held out,
    and unless the optimisation lowers their error by a tenth it is dropped. The map is polished
    (bends within its error are removed). OUT gets before.pfm, disparity.pfm, pictures, points.npz,
    loss.csv, loss.png, state.eqx and report.json.

    Args:
        scene: folder or file of a light field; `mvedge info` tells what it is.
        out: folder to make.
        supervised: fit to the scene's ground truth instead of the views.
        loss: what the views are asked, see above.
        routine: all parameters at once, or the thesis' turns (Q, Z, R, xy; 5 passes).
        iterations: in all for `joint`; per parameter and pass for `thesis` (13 there).
        features: what images are compared by, for `--loss reprojection`.
        vgg16: an .npz file of VGG16's first two convolutions, for `--features vgg16`.
        recycle: with `--supervised`, move points that contribute nothing to where the map is
            wrong, in rounds; their number stays the same.
        grow_points: points to add there besides; needs `--supervised`.
        subset: views drawn per iteration of `--loss reprojection`; all by default.
        raster: raster pixels per pixel and axis; the thesis has 2, which takes four times as long.
        views: use the central VIEWS x VIEWS views only; odd.
        scale: shrink the views by this factor, at most 1.
        state: a state.eqx of an earlier run with the same options, to go on from.
        seed: of random views.
        overwrite: replace OUT if it is an earlier result of mvedge, with nothing else in it.
    """
    extractor = _extractor(features, vgg16)
    if iterations < 1:
        raise ValueError(f"--iterations must be at least 1, got {iterations}.")
    if grow_points < 0:
        raise ValueError(f"--grow-points must not be negative, got {grow_points}.")
    if grow_points and not supervised:
        raise ValueError("--grow-points needs --supervised: without truth no residual is known.")
    with stage(f"reading {scene}"):
        light_field = load_light_field(scene, views=views, scale=scale)
    if supervised and light_field.truth is None:
        raise ValueError(f"{scene} has no ground truth, which --supervised needs.")
    blind = light_field.without_truth()
    sizes = ModelSizes(splat=SplatSizes(scale=raster))
    params, key = ModelParams.narrow(raster), jax.random.key(seed)
    inputs = [path for path in (scene, vgg16, state) if path is not None]
    with output_folder(out, inputs=inputs, overwrite=overwrite) as folder:
        with stage("estimating depth from edges"):
            call = Parameters(), blind, Sizes.for_light_field(blind)
            result = compiled(edge_to_depth, *call)(*call)
            first = jax.block_until_ready(result.disparity)
        points = result.points
        start = start_from_points(
            points.xy + result.surface.offset, points.disparity, points.error, points.valid,
            blind.centre_view, first, StartParams(),
        )  # fmt: skip
        objective: Supervised | SelfSupervised
        training, held_out = _split(gather_views(blind))
        refine, refinement = RefineParams(), None
        rates = Rates.evidence()
        origin = first
        if supervised:
            objective = _supervised(light_field, start.model, grow_points, params, sizes)
            start = Start(objective.trust.origin, objective.trust.error)
            rates = Rates.supervised()
        elif loss == "evidence":
            with stage("asking the views"):
                everyone = gather_views(blind, choice=all_views(blind))
                refinement = prepare_refinement(start, first, everyone, refine, params, sizes)
            start, objective, origin = refinement.start, refinement.objective, refinement.rendered
        else:
            with stage("fitting the model to that map"):
                extra = int(points.valid.sum()) // 10
                start = fit_to_map(start, first, StartParams(), params, sizes, extra=extra)
            objective = SelfSupervised(
                training, trust_labels(start), params, LossWeights(), extractor, sizes, subset
            )
            rates = Rates.self_supervised()
        table = (
            all_at_once(rates, iterations=iterations)
            if routine == "joint"
            else one_at_a_time(Rates(), iterations=iterations)
        )
        began = begin(start.model, origin, key=key)
        if state is not None:
            began = load_state(state, began)
        clock = time.perf_counter()
        if supervised and (recycle or grow_points):
            assert isinstance(objective, Supervised)
            final, history = _run_growing(began, table, objective, recycle=recycle)
        else:
            chunk = max(table.length // 4, 1)
            look = _progress(table)
            final, history = optimise(began, table, objective, chunk=chunk, after_chunk=look)
        seconds = time.perf_counter() - clock
        render = eqx.filter_jit(render_model)
        before, errors, kept = first, [], True
        if refinement is not None:
            after = finish_refinement(refinement, final.best, refine)
        else:
            after = render(final.best, params, sizes, start=final.disparity).disparity
        if not supervised:
            if refinement is None:
                # The model's own error in rendering the first map does not enter.
                after = before + after - render(start.model, params, sizes, start=before).disparity
            errors = [_explains(d, held_out, extractor) for d in (before, after)]
        if not supervised and refinement is None:
            kept = errors[1] < (1 - _MARGIN) * errors[0]
            after = polish(after if kept else before, PolishParams())
        with stage("writing"):
            scores = _write(folder, light_field, before, after, final, history)
            report = {
                "scene": light_field.name,
                "supervised": supervised,
                "iterations": int(final.iteration),
                "seconds": round(seconds, 2),
                "points": int(final.best.valid.sum()),
                "reprojection error before, after": errors,
                "share of proposals confirmed": (
                    None if refinement is None else float(refinement.correction.share.mean())
                ),
                "kept the optimised points": bool(kept),
                "scores": scores,
            }
            write_json(folder / "report.json", report)
    if not kept:
        warn(
            "the held-out views do not speak for the optimised points; the first map was polished."
        )
    for name, row in scores.items():
        note(f"{name}: " + "  ".join(f"{_COLUMNS[k]} {row[k]:.4g}" for k in _COLUMNS))
    note(f"{len(history.loss)} iterations, {seconds:.1f} s; written to {out}")


def _extractor(name: str, weights: Path | None) -> Features:
    if name == "vgg16":
        if weights is None:
            raise ValueError("--features vgg16 needs --vgg16 FILE, an .npz file of its weights.")
        return load_vgg16(weights)
    return FilterBank() if name == "filters" else Colours()


def _split(views: Views) -> tuple[Views, Views]:
    """Every second view on either arm trains, the others judge."""
    count = views.steps.shape[0]
    even = jnp.arange(0, count, 2)
    odd = jnp.arange(1, count, 2)
    return views.take(even), views.take(odd)


def _explains(disparity: jax.Array, views: Views, features: Features) -> float:
    run = eqx.filter_jit(self_supervised_loss)
    return float(run(disparity, views, LossWeights(), features=features)[1].reprojection)


def _supervised(
    light_field: LightField, model: DepthModel, extra: int, params: ModelParams, sizes: ModelSizes
) -> Supervised:
    truth = light_field.truth
    assert truth is not None
    rough = image_roughness(light_field.centre_view, jnp.asarray(0.3))
    model = without_free_places(eqx.tree_at(lambda m: m.roughness, model, rough))
    model = with_capacity(model, model.valid.size + extra)
    weights = SupervisedWeights(square=jnp.asarray(3.0))
    known = truth.disparity.astype(light_field.views.dtype)
    return Supervised(known, truth.valid, unlimited(model), params, weights, sizes)


def _progress(table: Routine) -> Callable[[State, History], None]:
    def look(state: State, history: History) -> None:
        note(f"  {int(state.iteration)}/{table.length} loss {float(history.loss[-1]):.6f}")

    return look


def _run_growing(
    state: State, table: Routine, objective: Supervised, *, recycle: bool
) -> tuple[State, History]:
    def tell(grown: Grown) -> None:
        moved, added = int(grown.recycled), int(grown.added) - int(grown.recycled)
        note(f"  {moved} points moved to where the map was wrong, {added} added")

    growth = GrowParams() if recycle else GrowParams(least=jnp.asarray(0.0))
    return optimise_growing(
        state, table, objective, growth, after_chunk=_progress(table), after_growth=tell
    )


def _write(
    folder: Path,
    light_field: LightField,
    before: jax.Array,
    after: jax.Array,
    state: State,
    history: History,
) -> dict[str, Any]:
    maps = {"before": before, "after": after}
    write_pfm(folder / "before.pfm", np.asarray(before))
    write_pfm(folder / "disparity.pfm", np.asarray(after))
    save_state(folder / "state.eqx", state)
    keep = np.asarray(state.best.valid)
    np.savez_compressed(
        folder / "points.npz",
        xy=np.asarray(state.best.xy)[keep],
        disparity=np.asarray(state.best.disparity)[keep],
        weight=np.exp(-np.asarray(state.best.log_weight))[keep],
        roughness=np.asarray(state.best.roughness),
    )
    with (folder / "loss.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["iteration", "loss", "grad_Q", "grad_Z", "grad_R", "grad_xy"])
        for i, (loss, norms) in enumerate(
            zip(np.asarray(history.loss), np.asarray(history.gradient), strict=True)
        ):
            writer.writerow([i, loss, *norms])
    figure = Figure(layout="constrained")
    axes = figure.subplots()
    axes.plot(np.asarray(history.loss))
    axes.set_xlabel("iteration")
    axes.set_ylabel("loss")
    figure.savefig(folder / "loss.png")
    truth = light_field.truth
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
