"""Depth from views that are noisy, dark, or of different brightness; ours and the plane sweep.

Both search the range that is measured in the changed views, out to whole and half pixels.

python experiments/robustness.py ../shared/data/hci/cotton --out results/robustness
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any, Literal, NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments._depth import as_image
from experiments._report import print_table, shared_data, write_json
from experiments._scenes import find_scene, over_common_range
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.edges import scene_range
from mvedge_jax.lightfield import GroundTruth, LightField
from mvedge_jax.metrics import depth_scores
from mvedge_jax.photometry.matching import plane_sweep


class Change(NamedTuple):
    """What is done to the views; then they are clipped and rounded to 8 bit."""

    noise: float = 0.0
    gain: float = 0.0
    brightness: float = 1.0
    gamma: float = 1.0


CHANGES = {
    "clean": Change(),
    "noise .01": Change(noise=0.01),
    "noise .02": Change(noise=0.02),
    "noise .05": Change(noise=0.05),
    "gain 5 %": Change(gain=0.05),
    "brightness x .5": Change(brightness=0.5),
    "brightness x .1": Change(brightness=0.1),
    "gamma 2.2": Change(gamma=2.2),
}


def changed(light_field: LightField, change: Change, *, every: bool = False) -> LightField:
    """The crosshair of a light field, or every view, after a change; range and truth forgotten.

    The crosshair is drawn first: horizontal arm, then the rest of the vertical one, with seed 0, so
    that figures compare with those of other programs and do not depend on `every`.
    """
    vc, uc = light_field.center
    rows, columns = light_field.views.shape[:2]
    cross = [(vc, u) for u in range(columns)] + [(v, uc) for v in range(rows) if v != vc]
    rest = [place for place in np.ndindex(rows, columns) if place not in cross] if every else []
    rng = np.random.default_rng(0)
    grid = np.zeros(light_field.views.shape, np.float32)
    there = np.zeros((rows, columns), bool)
    for places in filter(None, (cross, rest)):
        views = np.stack([np.asarray(light_field.views[v, u], np.float64) for v, u in places])
        views = views**change.gamma * change.brightness
        if change.gain:
            views = views * (1 + rng.normal(0, change.gain, len(places)))[:, None, None, None]
        if change.noise:
            views = views + rng.normal(0, change.noise, views.shape)
        if change != Change():
            views = np.round(255 * np.clip(views, 0, 1)) / 255
        for place, view in zip(places, views, strict=True):
            grid[place], there[place] = view, True
    return LightField(jnp.asarray(grid), available=there, name=light_field.name)


class Row(NamedTuple):
    """A row of the table with its maps."""

    figures: dict[str, Any]
    ours: jax.Array
    sweep: jax.Array


def measured(
    light_field: LightField,
    truth: GroundTruth,
    label: str,
    ranges: dict[str, tuple[float, float]],
    which: Literal["crosshair", "all"],
) -> Row:
    """Both methods on one changed light field, whose measured range is added to `ranges`."""
    views = changed(light_field, CHANGES[label], every=which == "all")
    start = time.perf_counter()
    low, high = scene_range(views)
    searching = time.perf_counter() - start
    views = over_common_range(views.with_range(low, high))
    model = EdgeDepth.for_light_field(views, views=which)
    jax.block_until_ready(model(views))
    start = time.perf_counter()
    found = jax.block_until_ready(model(views))
    seconds = time.perf_counter() - start
    sweep = plane_sweep(views, disparity_range=scene_range(views)).disparity
    ranges[label] = low, high
    clean = ranges.get("clean", (low, high))
    figures: dict[str, Any] = {"change": label}
    for name, disparity in (("", found.disparity), ("sweep ", sweep)):
        scores = depth_scores(disparity, truth.disparity, mask=truth.valid)
        figures |= {
            f"{name}MSE*100": float(scores.mse),
            f"{name}Q25*100": float(scores.q25),
            f"{name}BP(.01)": float(scores.bad_01),
            f"{name}BP(.03)": float(scores.bad_03),
            f"{name}BP(.07)": float(scores.bad_07),
        }
    figures |= {
        "range": f"{low:.2f}..{high:.2f}",
        "range off": max(abs(low - clean[0]), abs(high - clean[1])),
        "noise": float(found.stats.noise.deviation),
        "overflow": int(found.stats.edges.overflow),
        "s": round(seconds, 2),
        "range s": round(searching, 2),
    }
    return Row(figures, found.disparity, sweep)


def main() -> None:
    """Runs both methods on a scene under every change."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="+", help="paths of light fields, or synthetic names")
    parser.add_argument("--out", type=Path, default=Path("results/robustness"))
    parser.add_argument("--changes", nargs="*", choices=CHANGES, default=list(CHANGES))
    parser.add_argument("--size", type=int, default=512, help="side of rendered scenes, px")
    parser.add_argument("--all-views", action="store_true", help="labels from the whole grid")
    arguments = parser.parse_args()
    which = "all" if arguments.all_views else "crosshair"
    for name in arguments.scenes:
        light_field = find_scene(name, shared_data(), size=arguments.size)
        truth = light_field.truth
        if truth is None:
            raise ValueError(f"{name} has no ground truth to score against.")
        title, rows, strips, ranges = f"{Path(name).name}_{which}", [], [], {}
        for label in arguments.changes:
            row = measured(light_field, truth, label, ranges, which)
            rows.append(row.figures)
            print(json.dumps(row.figures), flush=True)
            maps = [as_image(m, truth.disparity) for m in (row.ours, row.sweep)]
            center = changed(light_field, CHANGES[label]).center_view
            picture = np.round(255 * np.asarray(center)).astype(np.uint8)[..., ::-1]
            strips.append(np.concatenate([picture, *maps], axis=1)[::2, ::2])
            # After every change: a run that is stopped leaves what it has.
            write_json(arguments.out / f"{title}.json", {"scene": title, "rows": rows})
            cv2.imwrite(str(arguments.out / f"{title}.png"), np.concatenate(strips))
        print_table(rows, title=f"{title}: full frame; the view, ours and the plane sweep")
        jax.clear_caches()


if __name__ == "__main__":
    main()
