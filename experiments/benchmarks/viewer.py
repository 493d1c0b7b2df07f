"""Size, loading time and frames per second of the viewer's page, measured in the page.

    python experiments/benchmarks/viewer.py --result RESULT --scene SCENE

RESULT is what `mvedge depth` wrote of SCENE. Needs Chromium and playwright. Chromium draws with the
processor here, not with a graphics card; each row says so.
"""

import os
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import tyro
from playwright.sync_api import sync_playwright

from mvedge_jax import viewer
from mvedge_jax.datasets import load_light_field

_RENDERER = """() => { const gl = document.createElement('canvas').getContext('webgl2');
  return gl.getParameter(gl.getExtension('WEBGL_debug_renderer_info').UNMASKED_RENDERER_WEBGL); }"""


@dataclass(frozen=True)
class Arguments:
    """Options.

    Attributes:
        result: folder that `mvedge depth` wrote.
        scene: the light field.
        qualities: of the views.
        seconds: how long frames are counted.
    """

    result: Path
    scene: Path
    qualities: tuple[int, ...] = (90, 50)
    seconds: float = 3.0


def main(options: Arguments) -> None:
    """Prints a row a quality."""
    field = load_light_field(options.scene)
    result = viewer.read_result(options.result)
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    flags = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    flags += ["--no-sandbox"] * (os.geteuid() == 0)
    with sync_playwright() as started, tempfile.TemporaryDirectory() as folder:
        browser = started.chromium.launch(executable_path=chromium, args=flags)
        for quality in options.qualities:
            path = Path(folder) / f"{quality}.html"
            path.write_text(viewer.page(field, result, quality=quality), encoding="utf-8")
            tab = browser.new_page(viewport={"width": 1280, "height": 900})
            tab.goto(path.as_uri())
            tab.evaluate("mvedge.ready")
            loaded = tab.evaluate("performance.now()") / 1000
            rate = tab.evaluate("seconds => mvedge.measure(seconds)", options.seconds)
            print(
                f"{tab.evaluate(_RENDERER)[:60]}: quality {quality}, "
                f"{path.stat().st_size / 1e6:.1f} MB, loaded after {loaded:.1f} s, "
                f"{rate:.1f} frames per second"
            )
            tab.close()
        browser.close()


if __name__ == "__main__":
    main(tyro.cli(Arguments))
