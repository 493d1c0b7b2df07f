"""Accuracy of the multi-view edges against ground truth, after each step and against nuisances.

    python experiments/edge_accuracy.py cotton backgammon --data ../shared/data
    python experiments/edge_accuracy.py synthetic:demo synthetic:wide --sweep

A point sits between two surfaces: the error is that of the best of the 3x3 pixels around it, and
that of the nearest pixel beside it. Coverage is the share of depth-edge pixels (a step above
0.1 px) with a point within 2 px. The thesis' own methods (plain filter response, alignment of
gradients, spatial vote, entropy search, joint filter) are rows of the table of steps. Where the
truth of every view is known, a second table counts the crossing lines that survive.
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from scipy import ndimage

from experiments._crossings import crossing_table
from experiments._report import print_table, shared_data, write_csv, write_json
from mvedge_jax import plotting
from mvedge_jax.datasets import load_light_field, synthetic
from mvedge_jax.depth import EdgeDepth, multiview_edges
from mvedge_jax.edges import EdgePoints, OrientedEdges
from mvedge_jax.edges.thesis import joint_filter
from mvedge_jax.lightfield import LightField


def load(name: str, data: Path | None, size: int) -> LightField:
    """A synthetic scene, a folder, or a scene of the benchmark by name."""
    if name.startswith("synthetic:"):
        scene = synthetic.scene(name.removeprefix("synthetic:"))
        return synthetic.render(scene, shape=(9, 9, size, size), key=jax.random.key(0))
    if Path(name).exists():
        return load_light_field(name)
    root = data or shared_data()
    if root is None:
        raise FileNotFoundError(f"{name} is not a folder, and --data was not given.")
    return load_light_field(root / "hci" / name)


def depth_edges(truth: np.ndarray, step: float = 0.1) -> np.ndarray:
    """Pixels on either side of a jump in disparity."""
    edges = np.zeros(truth.shape, bool)
    for axis in (0, 1):
        jump = np.abs(np.diff(truth, axis=axis)) > step
        before = [(0, 0), (0, 0)]
        after = [(0, 0), (0, 0)]
        before[axis], after[axis] = (1, 0), (0, 1)
        edges |= np.pad(jump, before) | np.pad(jump, after)
    return edges


def score(truth: np.ndarray, x: np.ndarray, y: np.ndarray, d: np.ndarray) -> dict[str, Any]:
    """One row of the table."""
    height, width = truth.shape
    x = np.clip(np.rint(x).astype(int), 0, width - 1)
    y = np.clip(np.rint(y).astype(int), 0, height - 1)
    padded = np.pad(truth, 1, mode="edge")
    best = np.min([np.abs(d - padded[y + j, x + i]) for j in range(3) for i in range(3)], axis=0)
    near = np.abs(d - truth[y, x])
    hit = np.zeros(truth.shape, bool)
    hit[y, x] = True
    edges = depth_edges(truth)
    covered = np.asarray(ndimage.distance_transform_edt(~hit))[edges] <= 2
    cells = (y // 16) * (width // 16 + 1) + x // 16
    signed = np.clip(d - truth[y, x], -0.07, 0.07)
    sums = np.bincount(cells, signed)
    counts = np.bincount(cells)
    return {
        "points": len(d),
        "median": float(np.median(best)),
        "< .03 %": 100 * float((best < 0.03).mean()),
        "< .07 %": 100 * float((best < 0.07).mean()),
        "> .5 %": 100 * float((best > 0.5).mean()),
        "nearest: median": float(np.median(near)),
        "nearest: < .07 %": 100 * float((near < 0.07).mean()),
        "nearest: > .5 %": 100 * float((near > 0.5).mean()),
        "coherent": float(np.median(np.abs(sums / np.maximum(counts, 1))[counts >= 8])),
        "coverage %": 100 * float(covered.mean()) if edges.any() else float("nan"),
    }


def lines(model: EdgeDepth, **choices: Any) -> EdgeDepth:
    """The model with other choices of how the thesis finds lines."""
    return model.replace({f"edges.lines.{name}": value for name, value in choices.items()})


def thesis_steps(light_field: LightField) -> list[dict]:
    """Rows of the table for the thesis' own chain, each with one step more or another."""
    assert light_field.truth is not None
    truth = np.asarray(light_field.truth.disparity)
    blind, key = light_field.without_truth(), jax.random.key(0)
    everything = EdgeDepth.for_light_field(blind, preset="thesis")
    off = {"levels": 1, "alignment": "none", "vote": False, "entropy": False}
    plain = lines(everything.replace({"edges.joint": False}), **off)
    run = lines(plain, alignment="run")
    both = lines(run, vote=True)
    searched = lines(both, entropy=True)
    smoothed = searched.replace({"edges.joint": True})
    variants = {
        "plain response, fitted lines (4.1.1, 4.1.2)": plain,
        "plain, modulated (Alg. 1)": lines(plain, modulate=True),
        "plain, between filters": lines(plain, interpolate=True),
        "plain, pyramid (4.1.4)": lines(plain, levels=2),
        "plain, aligned in a quarter of the rows (4.3)": lines(plain, alignment="count"),
        "plain, longest aligned run >= 4": run,
        "plain, spatial vote >= 8e-5 (4.2)": lines(plain, vote=True),
        "plain, run and vote": both,
        "  + entropy search (4.5)": searched,
        "    + joint filter (4.6)": smoothed,
        "      + pyramid: everything": everything,
        "        + between filters": lines(everything, interpolate=True),
    }
    table = []
    for name, variant in variants.items():
        points = multiview_edges(blind, variant, key=key).points
        keep = np.asarray(points.valid)
        x, y = np.asarray(points.xy)[keep].T
        row = score(truth, x, y, np.asarray(points.disparity)[keep])
        table.append({"step": f"thesis: {name}", **row})
    return table


def steps(light_field: LightField, *, thesis: bool):
    """The table after each step."""
    assert light_field.truth is not None
    truth = np.asarray(light_field.truth.disparity)
    blind = light_field.without_truth()
    table = thesis_steps(light_field) if thesis else []
    row, _ = final(light_field, {"edges.error_limit": 1e6})
    table.append({"step": "measured, all candidates", **row})
    row, points = final(light_field)
    table.append({"step": "  + those of small standard error: the result", **row})
    at = np.asarray(points.xy)
    keep = np.asarray(points.valid)
    px, py = np.clip(np.rint(at[keep]).astype(int).T, 0, np.array(truth.shape[::-1])[:, None] - 1)
    sigmas = (jnp.float32(sigma) for sigma in (5.0, 0.1, 0.5))
    smooth = joint_filter(points.xy, points.disparity, points.valid, blind.center_view, *sigmas)
    filtered = score(truth, px, py, np.asarray(smooth)[keep])
    table.append({"step": "    + joint filter (4.6)", **filtered})
    return table, points


def final(light_field: LightField, choices: Mapping[str, Any] | None = None):
    """The score of the whole point stage, and its points."""
    assert light_field.truth is not None
    points = found_points(light_field.without_truth(), choices)
    keep = np.asarray(points.valid)
    x, y = np.asarray(points.xy)[keep].T
    truth = np.asarray(light_field.truth.disparity)
    return score(truth, x, y, np.asarray(points.disparity)[keep]), points


def found_points(light_field: LightField, choices: Mapping[str, Any] | None = None) -> EdgePoints:
    """The points of the chain, with some choices by path."""
    model = EdgeDepth.for_light_field(light_field, choices=choices)
    return multiview_edges(light_field, model).points


def sweeps(light_field: LightField) -> list[dict]:
    """Noise, blur (Fig. B.3, B.4), number of views (Fig. A.4) and number of filters."""
    rows = []

    def add(name: str, field: LightField, choices: Mapping[str, Any] | None = None) -> None:
        rows.append({"step": name, **final(field, choices)[0]})

    rng = np.random.default_rng(0)
    views = np.asarray(light_field.views)

    def replaced(changed: np.ndarray) -> LightField:
        changed = np.clip(changed, 0, 1).astype(np.float32)
        return eqx.tree_at(lambda field: field.views, light_field, jnp.asarray(changed))

    for sigma in (0.0, 0.005, 0.01, 0.02, 0.04):
        noise = rng.normal(scale=sigma, size=views.shape) if sigma else 0.0
        add(f"noise, standard deviation {sigma:g}", replaced(views + noise))
    for sigma in (0.5, 1.0, 2.0):
        blurred = ndimage.gaussian_filter(views, (0, 0, sigma, sigma, 0))
        add(f"blur, standard deviation {sigma:g} px", replaced(blurred))
    for count in (7, 5, 3):
        if count <= min(views.shape[:2]):
            add(f"{count}x{count} views", light_field.crop_views(count))
    edges = EdgeDepth.for_light_field(light_field.without_truth()).edges
    assert isinstance(edges, OrientedEdges)
    for step in (0.05, 0.2, 0.3):
        first = int(np.floor(edges.ends[0] / step))
        count = int(np.ceil(edges.ends[1] / step)) - first + 1
        choices = {"edges.first": first, "edges.filters": count, "edges.spacing": step}
        add(f"{count} filters, {step:g} px apart", light_field, choices)
    return rows


def main(
    scenes: Annotated[tuple[str, ...], tyro.conf.Positional] = ("synthetic:demo",),
    *,
    data: Path | None = None,
    size: int = 256,
    thesis: bool = True,
    sweep: bool = False,
    out: Path = Path("results/edge_accuracy"),
) -> None:
    """Writes the table of every scene, and a picture of its points.

    Args:
        scenes: benchmark names, folders, or synthetic:NAME.
        data: folder that holds hci/; by default the development data beside the repository.
        size: side of synthetic views, px.
        thesis: include the thesis' own chain.
        sweep: also against noise, blur, number of views and number of filters.
        out: folder for tables and pictures.
    """
    everything = {}
    for name in scenes:
        light_field = load(name, data, size)
        table, points = steps(light_field, thesis=thesis)
        if sweep:
            table += sweeps(light_field)
        print_table(table, title=f"{name}: {light_field.views.shape[:4]}")
        label = name.replace(":", "_").replace("/", "_")
        write_csv(out / f"{label}.csv", table)
        everything[name] = table
        truth = light_field.truth
        if truth is not None and truth.view_ids is not None:
            met = crossing_table(light_field, found_points)
            print_table(met, title=f"{name}: lines that cross in horizontal EPIs")
            write_csv(out / f"{name.replace(':', '_').replace('/', '_')}_crossings.csv", met)
        figure = plotting.plot_edges(
            light_field.center_view,
            points.xy,
            points.disparity,
            valid=points.valid,
            name=name,
            width=8.0,
        )
        figure.savefig(out / f"{label}.png", dpi=200)
    write_json(out / "edge_accuracy.json", everything)


if __name__ == "__main__":
    tyro.cli(main)
