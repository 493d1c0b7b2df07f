"""Are standard errors true? Of the edge points, of labels, and of the final map.

    python experiments/calibration.py cotton backgammon room bench demo edges
    python experiments/calibration.py --map-only  # 13 scenes, vinyl, two rooms of photographs

Per scene: at the true map, the share of measured pixels (standard error below .03 px) that are off
by more than .03 px; for edge points, dense labels around the final map and the final map, the
share within two standard errors (95 % of a normal distribution), of the map also that within one
(68 %) and the area between its sparsification and the best one. A point or label sits between two
surfaces: its error is that against the best of the 3x3 pixels around it; that of the map is its
own. The picture has, by the size of the stated error, the error that 68 % of the pixels do not
exceed. The constants of the map's error were chosen on cotton, backgammon, bench, demo, edges and
slanted.
"""

import argparse
import sys
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments._report import print_table, shared_data, write_json
from experiments._scenes import DEVELOPMENT, find_scene, over_common_range
from mvedge_jax import plotting
from mvedge_jax.datasets import synthetic
from mvedge_jax.datasets.photographs import load_photographs
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import Calibration, calibration
from mvedge_jax.photometry import prepare_views
from mvedge_jax.photometry.measuring import labels
from mvedge_jax.posed import StereoDepth, reference_of, stereo

LabelViews = Literal["crosshair", "all"]
_MEASURED, _OFF = 0.03, 0.03
_ROOMS = ("livingroom5", "livingroom_wide5")
_LIVING_ROOM = (525.0, 525.0, 319.5, 239.5)


def nearest(disparity: np.ndarray, truth: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Error against the best of the 3x3 pixels around each place."""
    padded = np.pad(truth, 1, mode="edge")
    return np.min(
        [np.abs(disparity - padded[y + j, x + i]) for j in range(3) for i in range(3)], axis=0
    )


def measured(
    light_field: LightField, disparity: jax.Array, model: EdgeDepth
) -> tuple[np.ndarray, np.ndarray]:
    """Dense labels around a map, and their standard errors."""
    assert model.measurement is not None
    scene = model.calibration(light_field, model.searched)
    seen = prepare_views(scene, model.measurement)
    found = seen.accumulate(disparity)
    label = labels(found, scene.lab, disparity, seen.params, passes=seen.params.passes)
    return np.asarray(label.disparity), np.sqrt(np.asarray(label.variance))


def calibrated(
    name: str, size: int, which: LabelViews, *, map_only: bool
) -> tuple[dict[str, Any], Calibration]:
    """One row of the table and the curves of the final map."""
    light_field = over_common_range(find_scene(name, shared_data(), size=size))
    known = light_field.truth
    if known is None:
        raise ValueError(f"{name} has no ground truth to score against.")
    truth, valid = np.asarray(known.disparity), np.asarray(known.valid)
    blind = light_field.without_truth()
    model = EdgeDepth.for_light_field(blind, views=which)
    result = model(blind)
    curves = calibration(result.disparity, result.error, known.disparity, mask=known.valid)
    if map_only:
        return shares(name, curves), curves
    rows, columns = np.arange(truth.shape[0])[:, None], np.arange(truth.shape[1])[None]

    start = jnp.where(jnp.isfinite(known.disparity), known.disparity, 0)
    label, sigma = measured(blind, start, model)
    good = (sigma < _MEASURED) & valid
    off = 100 * float((np.abs(label - truth)[good] > _OFF).mean())

    label, sigma = measured(blind, result.disparity, model)
    good = (sigma < _MEASURED) & valid
    label_error = nearest(label, truth, rows, columns)[good]
    keep = np.asarray(result.points.valid)
    places = np.rint(np.asarray(result.points.xy)[keep]).astype(int)
    x = np.clip(places[:, 0], 0, truth.shape[1] - 1)
    y = np.clip(places[:, 1], 0, truth.shape[0] - 1)
    point_error = nearest(np.asarray(result.points.disparity)[keep], truth, y, x)
    row = {
        "measured %": 100 * float(good.mean()),
        "off at the truth %": off,
        "edges within two %": 100
        * float((point_error <= 2 * np.asarray(result.points.error)[keep]).mean()),
        "labels within two %": 100 * float((label_error <= 2 * sigma[good]).mean()),
    }
    return shares(name, curves) | row, curves


def shares(name: str, curves: Calibration) -> dict[str, Any]:
    """What a row of the table says of the map."""
    return {
        "scene": Path(name).name,
        "map within one %": 100 * float(curves.within[0]),
        "map within two %": 100 * float(curves.within[1]),
        "AUSE": float(curves.ause),
    }


def of_photographs(folder: Path, index: int = 2) -> tuple[dict[str, Any], Calibration]:
    """One row of the table and the curves of a room's depth from five photographs, half size."""
    view = load_photographs(folder, intrinsics=_LIVING_ROOM, scale=0.5)
    reference = reference_of(view, index)
    found = stereo(view.without_truth(), reference, StereoDepth.of(reference))
    assert view.depth is not None
    curves = calibration(found.depth, found.error, view.depth[index])
    return shares(folder.name, curves), curves


def _room(data: Path | None, name: str) -> Path:
    if data is None:
        raise ValueError(f"{name} is one of the development data, which are not there.")
    return data / "mvs" / name


def main() -> None:
    """Prints the table and draws the curves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", help="names or paths; all if none")
    parser.add_argument("--out", type=Path, default=Path("results/calibration"))
    parser.add_argument("--size", type=int, default=256, help="side of rendered scenes, px")
    parser.add_argument("--all-views", action="store_true", help="labels from the whole grid")
    parser.add_argument("--map-only", action="store_true", help="neither labels nor edges")
    arguments = parser.parse_args()
    data = shared_data()
    names = arguments.scenes or [*DEVELOPMENT, *synthetic.scene_names(), "vinyl", *_ROOMS]
    which = "all" if arguments.all_views else "crosshair"
    rows, curves = [], []
    for name in names:
        if name in _ROOMS:
            row, found = of_photographs(_room(data, name))
        else:
            row, found = calibrated(name, arguments.size, which, map_only=arguments.map_only)
        print(row, flush=True)
        rows.append(row)
        curves.append(found)
        jax.clear_caches()
    keys = [key for key in rows[0] if key != "scene"]
    means = {key: float(np.mean([r[key] for r in rows if key in r])) for key in keys}
    rows.append({"scene": "mean", **means})
    print_table(rows, title="Standard errors against the truth")
    write_json(arguments.out / "calibration.json", {"rows": rows})
    figure = plotting.plot_calibration(curves, names=[Path(n).name for n in names])
    figure.savefig(arguments.out / "calibration.png", dpi=150)


if __name__ == "__main__":
    main()
