"""Figures 5.4, 5.8, 5.9 and Appendix A: superpixels of all views, six metrics in both forms.

python experiments/figure_5_4.py --scenes demo edges --sizes 15 20 25 30 35 40
python experiments/figure_5_4.py --scenes edges --sweep color 3.5 7 14     (more in figure_a_1.py)
python experiments/figure_5_4.py --scenes edges --methods ours --sweep thesis.color 1 2 4
python experiments/figure_5_4.py --scenes edges --methods ours --sweep k-means.color 1 2 4
python experiments/figure_5_4.py --scenes edges --strides 1 2 4           (Fig. A.4)
python experiments/figure_5_4.py --scenes edges --methods thesis --bugs   (faults, one by one)
python experiments/figure_5_4.py --scenes edges --methods ours --noise 0.02
python experiments/figure_5_4.py --scenes demo --methods ours --repeats 3 (warm seconds)

`figure_5_4.png` has the means, `figure_a_5_SCENE.png` each scene (Figs. A.5 to A.10).
Published values are drawn dotted; what the authors' program scores on our scenes of 512 px is a
row. --noise disturbs one view, from the depth on, and tells how many labels change.
A scene is a folder, or a name of a synthetic scene or of one under --data. Depth is ours, estimated
once per scene and kept under --out. Where only the center view has true ids, that view is scored.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from _report import peak_memory, print_table, shared_data, write_csv, write_json
from _scenes import find_scene, stored
from _superpixels import MEASURED, changed, plot_sizes, plot_wrong, torn
from jax import Array, lax
from peers.kmeans import KMeansParams, KMeansSizes, kmeans_superpixels
from peers.lfsp import BUGS, LfspParams, LfspSizes, thesis_superpixels
from peers.superpixel_scores import code_scores

from mvedge_jax import lean_jit, plotting
from mvedge_jax.all_views import ViewDepth, ViewDepths, depth_of_views
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics.superpixels import labels_per_pixel, superpixel_scores
from mvedge_jax.superpixels import SuperpixelClustering, superpixels
from mvedge_jax.warping import forward_warp, holes

TRUE = "k-means-true"
METHODS = ("ours", "thesis", "k-means", TRUE, "SLIC projected", "grid and true ids")
AnyParams = dict[str, Any] | LfspParams | KMeansParams
# The methods with parameters; those of the others are sizes or none at all.
SWEPT: dict[str, Any] = {
    "ours": SuperpixelClustering,
    "thesis": LfspParams,
    "k-means": KMeansParams,
}


class Case(NamedTuple):
    """A scene with what is known of it, `ids` and `truth` of all views or of the center view."""

    light_field: LightField
    depths: ViewDepths
    ids: Array
    truth: Array


def main() -> None:
    """Scores every method on every scene at every size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/figure_5_4"))
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scenes", nargs="+", default=["demo", "edges"])
    parser.add_argument("--pixels", type=int, default=512, help="side of rendered scenes, px")
    parser.add_argument("--sizes", type=float, nargs="+", default=[20.0])
    parser.add_argument("--methods", nargs="+", default=METHODS, choices=METHODS)
    parser.add_argument("--strides", type=int, nargs="+", default=[1], help="views left out")
    help_ = "parameter of ours, or thesis. or k-means.position, .disparity, .color, and its values"
    parser.add_argument("--sweep", nargs="+", default=[], help=help_)
    parser.add_argument("--bugs", action="store_true", help="those of the authors, one by one")
    parser.add_argument("--noise", type=float, help="standard deviation in one view, sRGB")
    parser.add_argument("--repeats", type=int, default=1, help="the least time of so many")
    arguments = parser.parse_args()
    if len(arguments.sweep) == 1:
        parser.error("--sweep needs values behind the name of the parameter.")
    if arguments.sweep:
        _swept(arguments.sweep[0], arguments.sweep[1:])
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for name in arguments.scenes:
        for stride in arguments.strides:
            case = case_of(arguments, name, stride)
            for label, size, method, params in _runs(arguments):
                labels, seconds = _timed(arguments.repeats, method, case, size, params)
                key = {"scene": name, "stride": stride, "method": label, "aimed": size}
                rows.append({**key, **score(labels, case), "seconds": round(seconds, 2)})
                _draw(arguments.out, f"{name}-{stride}-{label}-{size:g}", labels, case)
            print_table(_shown(rows, name, arguments.pixels), title=name)
            jax.clear_caches()
        # After every scene: a run that is stopped leaves what it has.
        write_csv(arguments.out / "figure_5_4.csv", rows)
        write_json(arguments.out / "figure_5_4.json", {"rows": rows, "peak memory": peak_memory()})
        plot_sizes(rows).savefig(arguments.out / "figure_5_4.png")
        mine = [row for row in rows if row["scene"] == name]
        plot_sizes(mine).savefig(arguments.out / f"figure_a_5_{Path(name).name}.png")
        if arguments.noise:
            print_table(_disturbed(arguments, name), title=f"{name}, one view with noise")


_SHOWN = (
    *("method", "aimed", "accuracy", "recall", "undersegmentation_once", "compactness"),
    *("self_similarity", "labels_per_pixel", "inconsistent", "pieces", "torn", "number_connected"),
    *("accuracy_code", "recall_code", "self_similarity_code", "seconds"),
)


def _shown(rows: list[dict], name: str, pixels: int) -> list[dict]:
    found = [{k: row[k] for k in _SHOWN} for row in rows if row["scene"] == name]
    if pixels == 512 and name in MEASURED:
        nothing = dict.fromkeys(_SHOWN, float("nan"))
        found.append({**nothing, "method": "authors' program", "aimed": 20, **MEASURED[name]})
    return found


def _timed(repeats: int, method: str, *given: Any) -> tuple[Array, float]:
    """Labels, and the least time in seconds; the first one compiles."""
    labels, times = jnp.zeros((1, 1, 1, 1), jnp.int32), []
    for _ in range(repeats):
        start = time.perf_counter()
        labels = jax.block_until_ready(cut(method, *given))
        times.append(time.perf_counter() - start)
    return labels, min(times)


def _runs(arguments: Any) -> Iterator[tuple[str, float, str, AnyParams]]:
    """Name, size, method and parameters of every row."""
    for size in arguments.sizes:
        for method in arguments.methods:
            yield method, size, method, {"size": size}
        for bug in BUGS if arguments.bugs else ():
            yield f"thesis, {bug}", size, f"thesis, {bug}", {}
        if arguments.sweep:
            field, *values = arguments.sweep
            for label, kind, params in _swept(field, values, size=size):
                yield label, size, kind, params


def _swept(
    field: str, values: Sequence[str], *, size: float = 20.0
) -> list[tuple[str, str, AnyParams]]:
    """Name, method and parameters for every value of one of a method's parameters.

    Raises:
        SystemExit: no such method has such a parameter.
    """
    kind, name = field.rsplit(".", 1) if "." in field else ("ours", field)
    if kind not in SWEPT:
        raise SystemExit(f"--sweep {field}: a method must be one of {list(SWEPT)}, got {kind!r}.")
    names = _numbers(SWEPT[kind])
    if name not in names:
        raise SystemExit(f"--sweep {field}: {kind} has {', '.join(names)}; got {name!r}.")
    rows: list[tuple[str, str, AnyParams]] = []
    for value in values:
        number = jnp.asarray(float(value))
        if kind == "ours":
            chosen: AnyParams = {"size": size, name: number}
        else:
            chosen = replace(SWEPT[kind](), **{name: number})
        rows.append((f"{kind}, {name} {value}", kind, chosen))
    return rows


def _numbers(kind: type[SuperpixelClustering | LfspParams | KMeansParams]) -> list[str]:
    """The numbers of a method, by the fields that say a unit."""
    return [field.name for field in fields(kind) if "unit" in field.metadata]  # pyright: ignore


def case_of(arguments: Any, name: str, stride: int) -> Case:
    """A scene with its depth, from --out if it was estimated before."""
    light_field, ids, truth = _scene(arguments, name)
    middle = [n // 2 % stride for n in light_field.views.shape[:2]]
    thin = (slice(middle[0], None, stride), slice(middle[1], None, stride))
    wide = ids.shape[:2] == light_field.views.shape[:2]
    light_field = LightField(light_field.views[thin], available=light_field.available[thin])
    ids, truth = (ids[thin], truth[thin] * stride) if wide else (ids, truth * stride)
    file = arguments.out / f"{name}-{arguments.pixels}-{stride}.npz"
    if not file.exists():
        found = _depths(light_field)
        np.savez(
            file,
            disparity=np.asarray(found.disparity),
            error=np.asarray(found.error),
            source=np.asarray(found.source),
            overflow=np.asarray(found.overflow),
        )
        jax.clear_caches()
    with np.load(file) as kept:
        depths = ViewDepths(*(jnp.asarray(kept[key]) for key in ViewDepths._fields))
    return Case(light_field, depths, jnp.asarray(ids, jnp.int32), jnp.asarray(truth))


def _depths(light_field: LightField) -> ViewDepths:
    result = EdgeDepth.for_light_field(light_field)(light_field)
    model = ViewDepth.for_light_field(light_field)
    return depth_of_views(light_field, result, model)


def _scene(arguments: Any, name: str) -> tuple[LightField, np.ndarray, np.ndarray]:
    """A light field, the true ids and disparities of its views or of its center view."""
    folder = stored(name, arguments.data)
    light_field = find_scene(name, arguments.data, size=arguments.pixels)
    if folder is not None and (folder / "truth.npz").exists():
        with np.load(folder / "truth.npz") as known:
            disparity = known["offset"] + known["scale"] * known["disparity"].astype(np.float32)
            return light_field, known["ids"], disparity.astype(np.float32)
    truth = light_field.truth
    if truth is None or truth.object_ids is None:
        raise SystemExit(f"scene {name} has no object ids to score against.")
    if truth.view_ids is None or truth.view_disparity is None:
        one = truth.object_ids[None, None], truth.disparity[None, None]
        return light_field, np.asarray(one[0]), np.asarray(one[1])
    return light_field, np.asarray(truth.view_ids), np.asarray(truth.view_disparity)


def cut(method: str, case: Case, size: float, params: AnyParams) -> Array:
    """Labels of all views."""
    light_field, depths = case.light_field, case.depths
    center = depths.disparity[light_field.center]
    if method.startswith("thesis"):
        chosen = params if isinstance(params, LfspParams) else LfspParams()
        bugs = tuple(method.split(", ")[1:])
        return thesis_superpixels(light_field, chosen, LfspSizes(round(size), bugs=bugs))
    if method in ("k-means", TRUE):
        if method == TRUE:
            rows, columns = case.truth.shape[:2]
            center = case.truth[rows // 2, columns // 2]
        weights = params if isinstance(params, KMeansParams) else KMeansParams()
        return kmeans_superpixels(light_field, center, weights, KMeansSizes(size=round(size)))
    if method == "SLIC projected":
        return _projected(_slic(light_field.center_view, size), center, light_field.steps)
    if method == "grid and true ids":
        return _perfect(case, size)
    choices = params if isinstance(params, dict) else {}
    model = SuperpixelClustering.for_depths(depths, choices=choices)
    return superpixels(light_field, depths, model).labels


def _slic(image: Array, size: float) -> Array:
    from skimage.segmentation import slic

    picture = np.asarray(image, float)
    wanted = asked = picture[..., 0].size / size**2
    found = []
    # It makes fewer than it is asked for.
    for _ in range(4):
        labels = slic(picture, n_segments=round(asked), compactness=10.0)
        number = len(np.unique(labels))
        found.append((abs(number / wanted - 1), labels))
        asked *= wanted / number
    best = min(found, key=lambda pair: pair[0])[1]
    return jnp.asarray(best, jnp.int32)


@lean_jit
def _projected(labels: Array, disparity: Array, steps: Array) -> Array:
    """Labels of the center view moved to all views by its map; holes go on from behind."""

    def one(step: Array) -> Array:
        moved = forward_warp(labels[..., None].astype(disparity.dtype), disparity, step)
        behind = holes(moved.disparity, moved.hit).behind
        return moved.image[..., 0].ravel()[behind].astype(jnp.int32)

    maps = lax.map(one, steps.reshape(-1, 2))
    return maps.reshape(*steps.shape[:2], *labels.shape)


def _perfect(case: Case, size: float) -> Array:
    """Square cells in the center view's coordinates times true objects."""
    rows, columns, height, width = case.truth.shape
    y, x = (a.astype(case.truth.dtype) for a in jnp.indices((height, width)))
    v, u = (a.astype(case.truth.dtype)[..., None, None] for a in jnp.indices((rows, columns)))
    row = jnp.floor((y - (rows // 2 - v) * case.truth + 0.5) / size).astype(jnp.int32)
    column = jnp.floor((x - (columns // 2 - u) * case.truth + 0.5) / size).astype(jnp.int32)
    far = 64
    across = width + 2 * far
    ids = case.ids - jnp.min(case.ids)
    return 1 + ((row + far) * across + column + far) * (jnp.max(ids) + 1) + ids


def score(labels: Array, case: Case) -> dict[str, float]:
    """All forms of the metrics, and the share of torn superpixels."""
    if case.ids.shape != labels.shape:
        labels = labels[case.light_field.center][None, None]
    scores = superpixel_scores(labels, case.ids, case.truth)
    known = {name: float(value) for name, value in scores._asdict().items()}
    known |= code_scores(*map(np.asarray, (labels, case.ids, case.truth)))
    return {**known, "torn": torn(np.asarray(labels), np.asarray(case.truth))}


def _disturbed(arguments: Any, name: str) -> list[dict]:
    """How many pixels get another superpixel where one view has noise."""
    case, size = case_of(arguments, name, 1), arguments.sizes[0]
    params, rows = {"size": size}, []
    before = np.asarray(cut("ours", case, size, params))
    vc, uc = case.light_field.center
    for where, view in (
        ("in the center row", (vc, 0)),
        ("in the corner", (0, 0)),
        ("center", (vc, uc)),
    ):
        noise = arguments.noise * jax.random.normal(jax.random.key(0), before.shape[2:] + (3,))
        views = case.light_field.views.at[view].add(noise).clip(0, 1)
        light_field = LightField(views, available=case.light_field.available)
        for depths, kept in ((case.depths, "kept"), (_depths(light_field), "estimated again")):
            other = case._replace(light_field=light_field, depths=depths)
            after = np.asarray(cut("ours", other, size, params))
            rows.append({"view": where, "depth": kept, "changed": changed(before, after)})
    return rows


def _draw(folder: Path, name: str, labels: Array, case: Case) -> None:
    """Superpixels in five views, and Fig. 5.9 where there is truth."""
    views = np.asarray(case.light_field.views)
    if labels.shape != views.shape[:4]:
        return
    plotting.plot_superpixels(views, np.asarray(labels)).savefig(folder / f"{name}.png")
    if case.truth.shape == labels.shape:
        counts = labels_per_pixel(labels, case.truth)
        plotting.plot_labels_per_pixel(counts).savefig(folder / f"{name}-labels.png")
        wrong = plot_wrong(np.asarray(labels), np.asarray(case.ids), case.light_field.center)
        wrong.savefig(folder / f"{name}-accuracy.png")


if __name__ == "__main__":
    main()
