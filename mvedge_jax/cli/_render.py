"""`mvedge render`: a synthetic light field in the HCI layout."""

from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import tyro

from mvedge_jax.datasets import synthetic, write_hci

from ._common import note, progress_bar
from ._output import output_folder


def render(
    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    /,
    *,
    views: int = 9,
    size: tuple[int, int] = (512, 512),
    samples: int = 3,
    seed: int = 0,
    textures: int | None = None,
    baseline: float = 1.0,
    vignette: float = 0.0,
    vignette_shift: float = 0.05,
    gain: float = 0.0,
    no_occlusions: bool = False,
    overwrite: bool = False,
) -> None:
    """Renders a synthetic scene with exact ground truth for every view.

    OUT becomes a scene folder of the HCI 4D benchmark: input_CamNNN.png, gt_disp_lowres.pfm,
    parameters.cfg; and beyond the benchmark, disparity and object ids of every view
    (gt_disp_lowres_CamNNN.pfm, objectids_lowres_CamNNN.png) and the views that show each pixel of
    the center view (visible_CamNNN.png).

    Args:
        name: demo, slanted, edges, thin, textureless, wide, noisy, specular or crossing.
        out: folder to write.
        views: VIEWS x VIEWS views, an odd number.
        size: height and width in px.
        samples: rays per pixel along each side of a pixel.
        seed: seed of the sensor's noise, of vignettes and gains.
        textures: seed of another set of textures; None for the default set.
        baseline: factor of the distance between neighboring cameras, and so of disparities. 1.4
            for `wide` gives -5 to 5 px per view step.
        vignette: relative loss of brightness in the corners, 0 to 1.
        vignette_shift: standard deviation of the vignette's center over the shorter side of the
            views; each view has its own.
        gain: standard deviation of the brightness of the views, relative.
        no_occlusions: do not write visible_CamNNN.png.
        overwrite: replace OUT if it is a result of mvedge without other files in it.
    """
    key = None if textures is None else jax.random.key(textures)
    scene = synthetic.scene(name, key=key)
    scene = scene.spaced(baseline).through_lenses(
        vignette=vignette, vignette_shift=vignette_shift, gain=gain
    )
    shape = (views, views, *size)
    center = (views // 2, views // 2)
    with output_folder(out, overwrite=overwrite) as folder, progress_bar() as bar:
        task = bar.add_task("rendering", total=views * views)

        def advance(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        light_field = synthetic.render(
            scene, shape=shape, samples=samples, progress=advance, key=jax.random.key(seed)
        )
        visible = None
        if not no_occlusions:
            task = bar.add_task("occlusions", total=views * views)
            visible = np.empty(shape, bool)
            for k, (v, u) in enumerate(np.ndindex(views, views), start=1):
                visible[v, u] = synthetic.visibility(
                    scene, shape=shape, source=center, target=(v, u)
                )
                advance(k, views * views)
        task = bar.add_task("writing", total=views * views)
        write_hci(light_field, folder, visible=visible, progress=advance)
    note(f"{out}: {scene.name}, {views}x{views} views of {size[1]}x{size[0]} px")
