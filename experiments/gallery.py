"""Pictures of the gallery and the viewer's page, and the moving one of the README, all generated.

Those of the viewer need Chromium and playwright (`pip install mvedge_jax[test]`).

    python experiments/gallery.py --out docs/images/gallery
"""

import io
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro
from matplotlib.figure import Figure
from PIL import Image

from mvedge_jax import ViewDepth, depth, depth_of_views, plotting, viewer
from mvedge_jax.color import srgb_to_gray
from mvedge_jax.datasets import synthetic
from mvedge_jax.depth import DepthResult
from mvedge_jax.edges.sides import DirectionalDiffusion, bidirectional
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import boundary_scores, calibration
from mvedge_jax.photometry.matching import plane_sweep
from mvedge_jax.superpixels import SuperpixelClustering, superpixels

# What each picture of the viewer shows: the settings, by name.
_SHOTS: dict[str, dict[str, Any]] = {
    "field": {"mode": "F", "at": [42, 118], "focus": 0.0},
    "refocus": {"mode": "F", "aperture": 4, "focus": 0.6},
    "overlay": {"mode": "F", "aperture": 0, "color": "standard error", "opacity": 0.9, "u": 3},
    "geometry": {"mode": "G", "u": 0, "yaw": 0.25},
    "uncertain": {
        "mode": "G",
        "colors": "standard error",
        "byError": True,
        "normals": True,
        "hidden": False,
    },
    "compare": {"mode": "C", "compare": "side by side"},
    "difference": {"mode": "C", "compare": "difference"},
    "edit": {"mode": "E", "at": [70, 95], "cardDisparity": 0.0},
}


@dataclass(frozen=True)
class Arguments:
    """Options.

    Attributes:
        out: folder for the pictures.
        size: side of a view, px.
        animated: side of a view of the animation, px, which is shown at three quarters of it.
    """

    out: Path = Path("docs/images/gallery")
    size: int = 192
    animated: int = 384


def main(options: Arguments) -> None:
    """Renders the scene, estimates its depth, and draws."""
    options.out.mkdir(parents=True, exist_ok=True)
    shape = (9, 9, options.size, options.size)
    scene = synthetic.scene("demo")
    light_field = synthetic.render(scene, shape=shape, key=jax.random.key(0))
    blind = light_field.without_truth()
    result = depth(blind)
    swept = plane_sweep(blind).disparity
    for name, figure in pictures(light_field, result, swept):
        figure.savefig(options.out / f"{name}.webp", dpi=130, pil_kwargs={"quality": 80})
        print(options.out / f"{name}.webp")
    depths = depth_of_views(blind, result, ViewDepth.for_light_field(blind))
    maps = (np.asarray(each) for each in (depths.disparity, depths.error, depths.source))
    hidden = viewer.hidden_surfaces(light_field, *maps)
    shown = [
        viewer.result_of(result, name="edges")._replace(hidden=hidden),
        viewer.Result("plane sweep", np.asarray(swept)),
    ]
    for path in screenshots(viewer.page(light_field, *shown), options.out):
        print(path)
    shape = (9, 9, options.animated, options.animated)
    print(animation(synthetic.render(scene, shape=shape, key=jax.random.key(0)), options.out))


def pictures(
    light_field: LightField, result: DepthResult, swept: jax.Array
) -> Iterator[tuple[str, Figure]]:
    """The figures of `plotting`, one by one with their names."""
    assert light_field.truth is not None
    truth = np.asarray(light_field.truth.disparity)
    points, limits = result.points, plotting.disparity_limits([truth])
    names = ["plane sweep", "edges"]
    row = light_field.views.shape[2] // 2
    yield "views", plotting.plot_views(light_field)
    yield "epi", plotting.plot_epi(light_field, row=row)
    yield (
        "edges",
        plotting.plot_edges(
            light_field.center_view, points.xy, points.disparity, valid=points.valid, limits=limits
        ),
    )
    yield (
        "disparity",
        plotting.plot_disparity(
            [truth, swept, result.disparity], names=["truth", *names], limits=limits
        ),
    )
    yield (
        "comparison",
        plotting.plot_comparison(
            [swept, result.disparity], truth, names=names, image=light_field.center_view
        ),
    )
    yield "error", plotting.plot_error(result.disparity, truth, kind="signed")
    gray = srgb_to_gray(light_field.center_view)
    passes = bidirectional(points, gray, DirectionalDiffusion())
    yield (
        "passes",
        plotting.plot_disparity(
            [passes.forward, passes.backward], names=["+ normal", "- normal"], limits=limits
        ),
    )
    found = calibration(result.disparity, result.error, light_field.truth.disparity)
    yield "calibration", plotting.plot_calibration([found], names=["edges"])
    scores = [boundary_scores(m, light_field.truth.disparity) for m in (swept, result.disparity)]
    yield "boundaries", plotting.plot_precision_recall(scores, names=names)


def animation(light_field: LightField, out: Path) -> Path:
    """Around the grid: the views, the depth of every view, and superpixels in every view."""
    blind = light_field.without_truth()
    result = depth(blind)
    depths = depth_of_views(blind, result, ViewDepth.for_light_field(blind))
    cells = SuperpixelClustering.for_depths(depths)
    labels = np.asarray(superpixels(blind, depths, cells).labels)
    views, maps = np.asarray(light_field.views), np.asarray(depths.disparity)
    panels = zip(
        plotting.superpixel_frames(views, np.ones_like(labels)),  # one label: no contours
        plotting.view_frames(maps),
        plotting.superpixel_frames(views, labels),
        strict=True,
    )
    frames = [Image.fromarray(np.concatenate(each, axis=1)) for each in panels]
    small = [f.resize((3 * f.width // 4, 3 * f.height // 4), Image.Resampling.BOX) for f in frames]
    path = out / "around.webp"
    small[0].save(
        path, save_all=True, append_images=small[1:], duration=70, loop=0, quality=60, method=6
    )
    return path


def screenshots(html: str, out: Path) -> Iterator[Path]:
    """The viewer's page in its modes; nothing where there is no browser."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        print("no pictures of the viewer: Chromium is not installed")
        return
    from playwright.sync_api import sync_playwright

    flags = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    flags += ["--no-sandbox"] * (os.geteuid() == 0)
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=chromium, args=flags)
        tab = browser.new_page(viewport={"width": 1100, "height": 800})
        tab.set_content(html)
        tab.evaluate("mvedge.ready")
        for name, settings in _SHOTS.items():
            tab.evaluate("s => Object.entries(s).forEach(e => mvedge.set(...e))", settings)
            tab.wait_for_timeout(300)
            path = out / f"viewer_{name}.webp"
            Image.open(io.BytesIO(tab.screenshot())).save(path, quality=70)
            yield path
        browser.close()


if __name__ == "__main__":
    main(tyro.cli(Arguments))
