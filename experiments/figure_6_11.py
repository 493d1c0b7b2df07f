"""Figures 6.7, 6.11 and B.10: a card put into all views, half behind what is there.

    python experiments/figure_6_11.py --scenes room edges --out results/figure_6_11
    python experiments/figure_6_11.py --scenes lytro/2067 --views 7

The depth of every view tells which of its pixels hide the card: ours, the center view's map moved,
and the thesis' maps, see `every_view.py`. The card stands where the first map has the largest steps
(6.11) and where it has the next (B.10), in the middle of the two surfaces. Where the truth of all
views is known, `wrong %` are the pixels of the off-center views that differ from the card put in by
the truth, as a share of the card's own area.
"""

import argparse
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from _report import print_table, write_csv, write_json
from _views import scene
from every_view import METHODS
from matplotlib.figure import Figure
from scipy import ndimage

from mvedge_jax.depth import EdgeDepth
from mvedge_jax.edit import insert_picture
from mvedge_jax.lightfield import LightField

# RGB that differs by more is another surface.
_DIFFERS = 0.02


def card(side: int) -> np.ndarray:
    """A sheet of checks within a frame, RGBA, `side` px wide and one and a half times as tall."""
    y, x = np.mgrid[: side * 3 // 2, :side]
    checks = (y * 9 // y.shape[0] + x * 6 // side) % 2
    frame = (np.minimum(y, y[::-1]) < side // 12) | (np.minimum(x, x[:, ::-1]) < side // 12)
    colors = np.where(checks[..., None], [0.95, 0.85, 0.3], [0.75, 0.15, 0.2])
    colors = np.where(frame[..., None], 1.0, colors)
    return np.concatenate([colors, np.ones((*y.shape, 1))], -1).astype(np.float32)


def places(disparity: np.ndarray, size: tuple[int, int]) -> list[tuple[tuple[float, float], float]]:
    """Where two cards stand, `(x, y)`, and their disparity: on the two largest steps."""
    # Of the disparities within a card, all but the outliers.
    low, high = (ndimage.percentile_filter(disparity, q, size=size) for q in (20, 80))
    step = (high - low).copy()
    height, width = (n // 2 + 1 for n in size)
    step[:height] = step[-height:] = step[:, :width] = step[:, -width:] = 0
    found = []
    for _ in range(2):
        y, x = (int(n) for n in np.unravel_index(step.argmax(), step.shape))
        found.append(((float(x), float(y)), float(low[y, x] + high[y, x]) / 2))
        # The cards do not overlap.
        step[max(y - 2 * height, 0) : y + 2 * height, max(x - 2 * width, 0) : x + 2 * width] = 0
    return found


def main() -> None:
    """Draws both cards of every scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/figure_6_11"))
    parser.add_argument("--scenes", nargs="+", default=["edges"])
    parser.add_argument("--size", type=int, default=256, help="side of rendered scenes, px")
    parser.add_argument("--views", type=int, default=9, help="use the central VIEWS x VIEWS only")
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for place in arguments.scenes:
        name = Path(place).name
        light_field = scene(place, arguments.size).crop_views(arguments.views)
        blind, known = light_field.without_truth(), light_field.truth
        result = EdgeDepth.for_light_field(blind)(blind)
        maps = {method: METHODS[method](blind, result) for method in arguments.methods}
        if known is not None and known.view_disparity is not None:
            maps["truth"] = known.view_disparity
        picture = card(light_field.views.shape[3] // 5)
        spots = places(np.asarray(result.disparity), picture.shape[:2])
        for figure, (at, disparity) in zip(("6_11", "b_10"), spots, strict=True):
            edited = {
                method: insert_picture(
                    blind, every, jnp.asarray(picture), at=at, disparity=disparity
                ).views
                for method, every in maps.items()
            }
            rows += _scores(name, figure, edited, blind)
            drawn = _plot(blind, edited)
            drawn.savefig(arguments.out / f"figure_{figure}_{name}.png")
        jax.clear_caches()
        print_table([row for row in rows if row["scene"] == name], title=name)
        if rows:
            write_csv(arguments.out / "figure_6_11.csv", rows)
        write_json(arguments.out / "figure_6_11.json", rows)


def _scores(
    name: str, figure: str, edited: dict[str, jax.Array], blind: LightField
) -> list[dict[str, Any]]:
    """Wrong pixels over those of the true card, in the off-center views."""
    truth = edited.get("truth")
    if truth is None:
        return []
    off = np.ones(truth.shape[:2], bool)
    off[blind.center] = False

    def differs(one: jax.Array, other: jax.Array) -> int:
        return int((np.abs(np.asarray(one - other)).max(-1) > _DIFFERS)[off].sum())

    area = max(differs(truth, blind.views), 1)
    return [
        {"scene": name, "figure": figure.replace("_", "."), "method": method,
         "wrong %": 100 * differs(views, truth) / area}
        for method, views in edited.items() if method != "truth"
    ]  # fmt: skip


def _plot(blind: LightField, edited: dict[str, jax.Array]) -> Figure:
    """A corner view: as it is, and with the card by every method."""
    shown = {"input": blind.views, **edited}
    figure = Figure(figsize=(3 * len(shown), 3.2), layout="constrained")
    for axes, (method, views) in zip(
        figure.subplots(1, len(shown), squeeze=False)[0], shown.items(), strict=True
    ):
        axes.imshow(np.clip(np.asarray(views[-1, -1]), 0, 1), interpolation="nearest")
        axes.set_title(method)
        axes.set_axis_off()
    return figure


if __name__ == "__main__":
    main()
