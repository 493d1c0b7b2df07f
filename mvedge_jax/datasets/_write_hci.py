"""Writing a light field in the layout of the HCI 4D benchmark."""

import configparser
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Array, Bool

from mvedge_jax.lightfield import LightField

from ._images import write_image
from ._pfm import write_pfm

_SENSOR_MM = 35.0  # the benchmark's; only its ratio to the focal length means anything


def write_hci(
    light_field: LightField,
    path: str | os.PathLike,
    *,
    visible: Bool[Array | np.ndarray, "v u y x"] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Writes a light field as a scene folder of the HCI 4D benchmark.

    | file | what |
    |---|---|
    | `input_CamNNN.png` | view `NNN = columns * row + column`, 8 bit sRGB |
    | `parameters.cfg` | cameras, size, disparity range |
    | `gt_disp_lowres.pfm` | disparity of the center view, px per view step |
    | `gt_depth_lowres.pfm` | the same as depth, meters |
    | `objectids_lowres.png` | object ids of the center view, 16 bit |
    | `gt_disp_lowres_CamNNN.pfm`, `objectids_lowres_CamNNN.png` | the same for every view |
    | `visible_CamNNN.png` | 255 where view `NNN` shows the center view's pixel, 0 elsewhere |

    The last two rows are more than the benchmark has, as are `positions_x` and `positions_y` of
    irregular views in `parameters.cfg`, row by row. `load_light_field` reads all but the last.

    Args:
        light_field: its missing views, and what is unknown of it, are left out.
        path: a folder, created if needed. Files of the same names are replaced.
        visible: occlusion masks of the center view, see `synthetic.visibility`.
        progress: called with the number of finished views and their total.

    Raises:
        OSError: if a file cannot be written.
        ValueError: if `visible` has another shape, ground truth is not known at every pixel (the
            layout has no place for a mask), or an object id does not fit 16 bits.
    """
    folder = Path(path)
    rows, columns, height, width, _ = light_field.views.shape
    if visible is not None and visible.shape != (rows, columns, height, width):
        raise ValueError(
            f"`visible` must have the shape {(rows, columns, height, width)}, got {visible.shape}."
        )
    truth = light_field.truth
    if truth is not None and not bool(truth.valid.all()):
        raise ValueError(
            f"`light_field.truth` is unknown at {int((~truth.valid).sum())} pixels, expected none: "
            "the HCI layout has no place for a mask; drop it with `without_truth()`."
        )
    folder.mkdir(parents=True, exist_ok=True)
    available = np.asarray(light_field.available)
    total = int(available.sum())
    for done, (v, u) in enumerate(np.argwhere(available), start=1):
        number = f"{columns * v + u:03d}"
        view = np.asarray(light_field.views[v, u], np.float32)
        pixels = np.clip(np.round(view * 255), 0, 255).astype(np.uint8)
        write_image(folder / f"input_Cam{number}.png", pixels[..., ::-1])
        if truth is not None and truth.view_disparity is not None:
            disparity = np.asarray(truth.view_disparity[v, u], np.float32)
            write_pfm(folder / f"gt_disp_lowres_Cam{number}.pfm", disparity)
        if truth is not None and truth.view_ids is not None:
            ids = np.asarray(truth.view_ids[v, u])
            _write_ids(folder / f"objectids_lowres_Cam{number}.png", ids)
        if visible is not None:
            mask = np.asarray(visible[v, u]).astype(np.uint8) * 255
            write_image(folder / f"visible_Cam{number}.png", mask)
        if progress is not None:
            progress(done, total)
    if truth is not None:
        disparity = np.asarray(truth.disparity, np.float32)
        write_pfm(folder / "gt_disp_lowres.pfm", disparity)
        if light_field.camera is not None:
            depth = np.asarray(light_field.camera.depth(truth.disparity), np.float32)
            write_pfm(folder / "gt_depth_lowres.pfm", depth)
        if truth.object_ids is not None:
            _write_ids(folder / "objectids_lowres.png", np.asarray(truth.object_ids))
    _write_parameters(folder / "parameters.cfg", light_field)


def _write_ids(path: Path, ids: np.ndarray) -> None:
    if ids.min() < 0 or ids.max() > 65535:
        raise ValueError(
            f"`light_field.truth` must have object ids from 0 to 65535 to fit {path.name}, got "
            f"{ids.min()} to {ids.max()}."
        )
    write_image(path, ids.astype(np.uint16))


def _write_parameters(path: Path, light_field: LightField) -> None:
    rows, columns, height, width, _ = light_field.views.shape
    config = configparser.ConfigParser()
    intrinsics = {"image_resolution_x_px": str(width), "image_resolution_y_px": str(height)}
    extrinsics = {"num_cams_x": str(columns), "num_cams_y": str(rows)}
    meta = {"scene": light_field.name.replace("%", ""), "category": "mvedge_jax"}
    camera = light_field.camera
    if camera is not None:
        focal_mm = float(camera.focal_px) * _SENSOR_MM / max(height, width)
        intrinsics |= {"focal_length_mm": f"{focal_mm:.9g}", "sensor_size_mm": f"{_SENSOR_MM:.9g}"}
        extrinsics |= {
            "baseline_mm": f"{float(camera.baseline) * 1000:.9g}",
            "focus_distance_m": f"{float(camera.focus_distance):.9g}",
        }
    if light_field.positions is not None:
        for axis, key in enumerate(("positions_x", "positions_y")):
            values = np.asarray(light_field.positions)[..., axis]
            extrinsics[key] = " ".join(f"{value:.9g}" for value in values.flat)
    if light_field.disparity_range is not None:
        low, high = np.asarray(light_field.disparity_range)
        meta |= {"disp_min": f"{low:.7g}", "disp_max": f"{high:.7g}"}
    config.read_dict({"intrinsics": intrinsics, "extrinsics": extrinsics, "meta": meta})
    with path.open("w", encoding="utf-8") as stream:
        config.write(stream)
