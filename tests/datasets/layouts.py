"""Tiny light fields written in the real layouts."""

from pathlib import Path
from typing import Any, TypeVar

import cv2
import h5py
import numpy as np
import scipy.io

from mvedge_jax.datasets import write_pfm

CONFIGURATION = """[intrinsics]
focal_length_mm = 100.0
image_resolution_x_px = {width}
image_resolution_y_px = {height}
sensor_size_mm = 35.0

[extrinsics]
num_cams_x = {columns}
num_cams_y = {rows}
baseline_mm = 25.0
focus_distance_m = 4.25

[meta]
scene = toy
disp_min = -1.5
disp_max = 1.25
"""


_T = TypeVar("_T")


def known(value: _T | None) -> _T:
    """The value, which the test expects to be there."""
    assert value is not None
    return value


def random_views(shape=(3, 3, 6, 8, 3), dtype: Any = np.uint8, seed=0) -> np.ndarray:
    """Views that no two files share, `[v, u, y, x, c]`."""
    high = np.iinfo(dtype).max + 1
    return np.random.default_rng(seed).integers(0, high, shape).astype(dtype)


def save_image(path: Path, rgb: np.ndarray) -> None:
    """Writes RGB with OpenCV."""
    assert cv2.imwrite(str(path), rgb[..., ::-1] if rgb.ndim == 3 else rgb)


def write_hci(folder: Path, views: np.ndarray, *, disparity=None, settings=True) -> Path:
    """The HCI 4D benchmark's layout."""
    folder.mkdir(parents=True, exist_ok=True)
    rows, columns, height, width = views.shape[:4]
    for row in range(rows):
        for column in range(columns):
            save_image(folder / f"input_Cam{columns * row + column:03d}.png", views[row, column])
    if settings:
        text = CONFIGURATION.format(width=width, height=height, columns=columns, rows=rows)
        (folder / "parameters.cfg").write_text(text)
    if disparity is not None:
        write_pfm(folder / "gt_disp_lowres.pfm", disparity)
    return folder


def write_grid(folder: Path, views: np.ndarray, *, pattern="lf_{:02d}_{:02d}.png", first=1) -> Path:
    """A folder of images with row and column in the name."""
    folder.mkdir(parents=True, exist_ok=True)
    for row, column in np.ndindex(views.shape[:2]):
        save_image(folder / pattern.format(row + first, column + first), views[row, column])
    return folder


def write_stanford(
    folder: Path, views: np.ndarray, *, jitter=0.0, pitch=(60.0, 60.0), places=None
) -> Path:
    """The Stanford archive's layout: cameras `pitch` units apart, to the left and up.

    `places` are `[v, u, (x, y)]` instead.
    """
    folder.mkdir(parents=True, exist_ok=True)
    draw = np.random.default_rng(1)
    for row, column in np.ndindex(views.shape[:2]):
        start = np.array([-380.5 - pitch[1] * row, 1100.25 - pitch[0] * column])
        y, x = start if places is None else places[row, column][::-1]
        y, x = np.array([y, x]) + jitter * draw.uniform(-1, 1, 2)
        save_image(folder / f"out_{row:02d}_{column:02d}_{y:.6f}_{x:.6f}.png", views[row, column])
    return folder


def write_h5(path: Path, views: np.ndarray, *, depth=None, labels=None) -> Path:
    """The old HCI benchmark's layout."""
    with h5py.File(path, "w") as file:
        file["LF"] = views
        if depth is not None:
            file["GT_DEPTH"] = depth
        if labels is not None:
            file["GT_LABELS"] = labels
        file.attrs["dH"] = 0.1
        file.attrs["focalLength"] = 600.0
        file.attrs["shift"] = 10.0
    return path


def write_mat(path: Path, array: np.ndarray, *, version="7", name="LF") -> Path:
    """A MATLAB file; version 7.3 is HDF5 with the axes in reverse, behind a 512-byte header."""
    if version == "7":
        scipy.io.savemat(path, {name: array}, do_compression=True)
        return path
    with h5py.File(path, "w", userblock_size=512) as file:
        file[name] = array.transpose()
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + b"\0" * 8 + b"\0\2IM")
    return path


def cut(path: Path, fraction: float = 0.6) -> None:
    """Truncates a file."""
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * fraction)])
