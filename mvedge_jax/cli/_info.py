"""`mvedge info`: the contents of a light field, and a check of the order of its views."""

from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from mvedge_jax.datasets import ConventionCheck, check_convention, open_source
from mvedge_jax.lightfield import Camera, GroundTruth, LightField
from mvedge_jax.photometry.brightness import rough_brightness

from ._common import note, positions_of, stage, warn
from ._source import read_scene


def info(
    path: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")],
    /,
    *,
    views: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    scale: float = 1.0,
    flip_u: bool = False,
    flip_v: bool = False,
    swap_axes: bool = False,
    positions: Path | None = None,
    quick: bool = False,
) -> None:
    """Describes a light field and checks the order of its views.

    The check needs no ground truth: near surfaces must cover far ones. If they do not, it says
    which of --flip-u and --flip-v is needed.

    Args:
        path: folder or file of a light field (HCI, Stanford, Lytro, any grid of images).
        views: keep the central N x N views.
        scale: shrink the views by this factor as they are read.
        flip_u: reverse the view columns.
        flip_v: reverse the view rows.
        swap_axes: exchange view rows and columns, before they are reversed.
        positions: text file with a line `v u x y` per view: row, column, position in view steps.
        quick: skip the check of occlusions, which takes some seconds.
    """
    with open_source(path) as source:
        layout = source.layout
    with stage(f"reading {path}"):
        order = {"flip_u": flip_u, "flip_v": flip_v, "swap_axes": swap_axes}
        light_field, said = read_scene(path, views=views, scale=scale, positions=positions, **order)
    for doubt in said:
        warn(doubt)
    lines = [
        ("light field", f"{light_field.name} ({layout})"),
        ("views", _views(light_field)),
        ("positions", positions_of(light_field)),
        ("memory", f"{light_field.views.nbytes / 1e6:.0f} MB as {light_field.views.dtype}"),
        ("disparity range", _range(light_field.disparity_range, "px per view step")),
        ("ground truth", _truth(light_field.truth)),
        ("camera", _camera(light_field.camera, light_field.disparity_range)),
        *_photometry(light_field),
    ]
    if quick:
        _print(lines)
        return
    try:
        with stage("looking at the occlusions"):
            result = check_convention(light_field)
    except ValueError as reason:
        _print([*lines, ("convention", f"not checked: {reason}")])
        return
    if light_field.disparity_range is None:
        lines.append(("range, estimated", _range(result.disparity_range, "px per view step")))
    lines.append(("occlusions", _votes(result)))
    lines.append(("convention", _verdict(result)))
    _print(lines)
    if result.holds is False:
        warn(_advice(result, flip_u, flip_v, swap_axes))


def _print(lines: list[tuple[str, str]]) -> None:
    width = max(len(label) for label, _ in lines)
    for label, text in lines:
        note(f"{label:<{width}}  {text}")


def _views(light_field: LightField) -> str:
    rows, columns, height, width = light_field.views.shape[:4]
    present = np.asarray(light_field.available)
    text = f"{rows}x{columns} of {width}x{height} px (width x height), "
    if present.all():
        return text + "all there"
    cross = np.zeros_like(present)
    cross[rows // 2] = cross[:, columns // 2] = True
    if (present == cross).all():
        return text + f"the {int(present.sum())} of the crosshair only"
    missing = [f"({v}, {u})" for v, u in np.argwhere(~present)]
    shown = ", ".join(missing[:6]) + (", ..." if len(missing) > 6 else "")
    return text + f"{len(missing)} of {present.size} missing: (v, u) = {shown}"


def _range(limits, unit: str) -> str:
    if limits is None:
        return "unknown"
    low, high = (float(limit) for limit in limits)
    return f"{low:.3f} .. {high:.3f} {unit}"


def _truth(truth: GroundTruth | None) -> str:
    if truth is None:
        return "none"
    valid = np.asarray(truth.valid)
    disparity = np.asarray(truth.disparity)[valid]
    parts = [f"disparity {disparity.min():.3f} .. {disparity.max():.3f}"]
    if not valid.all():
        parts.append(f"known at {100 * valid.mean():.1f} % of the pixels")
    if truth.object_ids is not None:
        parts.append(f"{len(np.unique(np.asarray(truth.object_ids)))} object ids")
    extra = [
        name
        for name, values in (("disparity", truth.view_disparity), ("ids", truth.view_ids))
        if values is not None
    ]
    return ", ".join(parts) + (f", {' and '.join(extra)} of every view" if extra else "")


def _camera(camera: Camera | None, limits) -> str:
    if camera is None:
        return "unknown"
    text = (
        f"focal length {float(camera.focal_px):.1f} px, baseline "
        f"{1000 * float(camera.baseline):.3g} mm, disparity 0 at "
        f"{float(camera.focus_distance):.3g} m"
    )
    if limits is None:
        return text
    far, near = (float(distance) for distance in camera.depth(limits))
    return text + f", range {near:.3g} .. {far:.3g} m"


def _photometry(light_field: LightField) -> list[tuple[str, str]]:
    exposure, noise = rough_brightness(light_field.bare())
    scale, gain = float(exposure.scale), np.asarray(exposure.gain)
    vc, uc = light_field.center
    cross = np.concatenate([gain[vc], gain[:, uc]])
    most = 100 * float(np.max(exposure.unevenness))
    uneven = f"up to {most:.1f} % (standard deviation) against" if most else "none beyond"
    return [
        ("brightness", "as it is" if scale == 1 else f"dark; raised {scale:.2f} times"),
        ("gain of the views", f"{cross.min():.3f} .. {cross.max():.3f} of the center view's"),
        ("vignette of the views", f"{uneven} the center view's"),
        ("noise", f"{255 * float(noise.deviation) / scale:.2f} of 255 at most"),
    ]


def _votes(result: ConventionCheck) -> str:
    same, opposite = result.agreement
    return (
        f"columns {result.columns[0]} for and {result.columns[1]} against, rows "
        f"{result.rows[0]} for and {result.rows[1]} against; both axes see the same disparity at "
        f"{same} of {same + opposite} places"
    )


def _verdict(result: ConventionCheck) -> str:
    if result.holds:
        return "holds: near covers far along both axes"
    order = "rows and columns EXCHANGED; after that, " if result.swap_axes else ""
    words = {None: "cannot be told", True: "REVERSED", False: "right"}
    return f"{order}columns (u) {words[result.flip_u]}, rows (v) {words[result.flip_v]}"


def _advice(result: ConventionCheck, flip_u: bool, flip_v: bool, swap_axes: bool) -> str:
    used = {"--swap-axes": swap_axes, "--flip-u": flip_u, "--flip-v": flip_v}
    # After exchanging axes, a reversal along one axis is one along the other.
    across, down = (flip_v, flip_u) if result.swap_axes else (flip_u, flip_v)
    wanted = {
        "--swap-axes": swap_axes != result.swap_axes,
        "--flip-u": across != bool(result.flip_u),
        "--flip-v": down != bool(result.flip_v),
    }
    changes = [
        f"{'with' if wanted[option] else 'without'} {option}"
        for option in used
        if used[option] != wanted[option]
    ]
    reason = (
        "what moves along the rows of views moves up and down"
        if result.swap_axes
        else "far things cover near ones"
    )
    return f"the views disagree with the convention: {reason}. Load them {' and '.join(changes)}."
