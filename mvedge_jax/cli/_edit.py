"""`mvedge edit`: inserts pictures, paints or removes surfaces in every view."""

from pathlib import Path
from typing import Annotated

import cv2
import jax.numpy as jnp
import numpy as np
import tyro

from mvedge_jax import plotting
from mvedge_jax.datasets import read_raw, write_hci
from mvedge_jax.edit import insert_picture, paint, remove

from ._common import finite, in_unit_range, note, stage, warn
from ._every_view import every_view
from ._output import output_folder, write_json
from ._source import read_scene

# Margin around removed pixels that blend with them, px.
_BLENDED = 2
_NOTHING = (
    "nothing was changed: in every view, it is hidden by what is nearer, or lies outside; look at "
    "--at, --disparity or the mask."
)


def edit(
    scene: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    /,
    *,
    insert: Path | None = None,
    at: tuple[float, float] | None = None,
    disparity: float = 0.0,
    slant: tuple[float, float] = (0.0, 0.0),
    mask: Path | None = None,
    color: tuple[float, float, float] | None = None,
    overwrite: bool = False,
) -> None:
    """Edits a light field with correct occlusion in every view.

    One of three: --insert puts a picture with alpha on a plane; --mask with --color paints a
    surface of the center view; --mask alone removes the marked surface. OUT is a light field in the
    layout of the HCI benchmark, with views.png and report.json.

    Args:
        scene: folder or file of a light field; `mvedge info` checks it.
        out: folder to write.
        insert: picture to insert, with or without alpha.
        at: x and y of the picture's middle in the center view, px; by default the middle of the
            view.
        disparity: disparity of the picture, px per view step, larger is nearer.
        slant: change of its disparity per px along x and y.
        mask: picture of the center view's size, white in the pixels to edit.
        color: red, green and blue of the paint, 0..1.
        overwrite: replace OUT if it is a result of mvedge without other files in it.
    """
    if (insert is None) == (mask is None):
        raise ValueError("name either --insert or --mask, not both or none.")
    finite(at=at, disparity=disparity, slant=slant)
    in_unit_range(color)
    with stage("reading"):
        read, said = read_scene(scene)
        light_field = read.without_truth()
        given = _read(insert or mask)
    inputs = [scene, *(path for path in (insert, mask) if path is not None)]
    shape = light_field.views.shape[2:4]
    if mask is not None and given.shape[:2] != shape:
        raise ValueError(
            f"{mask} must have the size of the views, {shape[1]}x{shape[0]} px, got "
            f"{given.shape[1]}x{given.shape[0]}."
        )
    with output_folder(out, inputs=inputs, overwrite=overwrite) as folder:
        found, _, _, doubts = every_view(light_field)
        doubts = [*said, *doubts]
        depths = found.disparity
        with stage("editing"):
            white = jnp.asarray(given[..., :3].mean(-1) > 0.5)
            if mask is None:
                middle = ((shape[1] - 1) / 2, (shape[0] - 1) / 2) if at is None else at
                edited = insert_picture(
                    light_field, depths, jnp.asarray(given),
                    at=jnp.asarray(middle), disparity=jnp.asarray(disparity),
                    slant=jnp.asarray(slant),
                )  # fmt: skip
            elif color is not None:
                edited = paint(light_field, depths, white.astype(jnp.float32), jnp.asarray(color))
            else:
                edited = remove(light_field, depths, white, radius=_BLENDED)
            if bool(jnp.all(edited.views == light_field.views)):
                doubts = [*doubts, _NOTHING]
        with stage("writing"):
            write_hci(edited, folder)
            plotting.plot_views(edited).savefig(folder / "views.png")
            write_json(folder / "report.json", {"scene": light_field.name, "warnings": doubts})
    for doubt in doubts:
        warn(doubt)
    note(f"written to {out}")


def _read(path: Path | None) -> np.ndarray:
    """A picture as sRGB and alpha in [0, 1]."""
    if path is not None and path.suffix.lower() in (".png", ".jpg", ".jpeg", ".bmp"):
        image = read_raw(path)
    else:
        image = None if path is None else cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError(f"{path} could not be read as a picture.")
    levels = {np.dtype(np.uint8): 255, np.dtype(np.uint16): 65535}.get(image.dtype, 1)
    image = image.astype(np.float32) / levels
    if image.ndim == 2:
        image = np.stack([image] * 3, -1)
    alpha = image[..., 3:] if image.shape[2] == 4 else np.ones_like(image[..., :1])
    return np.concatenate([image[..., 2::-1], alpha], -1)
