"""Reads a photograph: undistorted, rotated, shrunk, with its depth and its opaque pixels."""

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float

from .._images import image_orientation, image_size, picked, read_cutout, read_raw
from ._posed_source import Frame, Lens, pinhole

# Share of a photograph that must be left where lens distortion is taken out, share of the frame
# that it must fill, and the least focal length, as a share of the frame, 168 degrees wide.
_KEPT, _FILLED, _SHORTEST = 0.3, 0.98, 0.05


# An interpolated pixel is opaque if its sources are, up to rounding.
_OPAQUE = 0.99


class Picture(NamedTuple):
    """An undistorted photograph.

    Attributes:
        image: sRGB in [0, 1], without distortion; black where it is transparent.
        matrix: intrinsics, px.
        depth: true depth, 0 where unknown; None if there is none.
        opaque: pixels interpolated from opaque ones; None for all.
        doubtful: whether it has an EXIF orientation and it is unknown if its camera is that of the
            rotated image.
    """

    image: Float[np.ndarray, "y x 3"]
    matrix: Float[np.ndarray, "3 3"]
    depth: Float[np.ndarray, "y x"] | None
    opaque: Bool[np.ndarray, "y x"] | None
    doubtful: bool


def read_picture(frame: Frame, depth_unit: float, scale: float) -> Picture:
    """Reads a photograph, takes out its distortion and shrinks it by `scale`.

    Files that are missing, damaged, of another size than the camera or the photograph, or too
    distorted are errors that name them. `depth_unit` is in units of the poses.
    """
    upright, doubtful = _upright(frame)
    stored, opaque = read_cutout(frame.image, upright=upright)
    shape = stored.shape[:2]
    lens = frame.lens
    if lens.size is not None and lens.size != shape:
        raise ValueError(
            f"{frame.image} has {shape[1]}x{shape[0]} px, its camera {lens.size[1]}x"
            f"{lens.size[0]}; expected the photographs that the model was made from."
        )
    matrix = lens.matrix
    # What the description did not give a size for could not be checked before.
    pinhole(
        matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2],
        where=f"the camera of {frame.image}", size=shape,
    )  # fmt: skip
    picture = stored.astype(np.float32) / np.float32(np.iinfo(stored.dtype).max)
    if opaque is not None:
        # The color of a transparent pixel is meaningless.
        picture = picture * opaque[..., None]
    depth = None
    if frame.depth is not None:
        depth = _stored_depth(frame.depth).astype(np.float32) * np.float32(depth_unit)
        if depth.shape != shape:
            raise ValueError(
                f"{frame.depth} has the shape {depth.shape}; expected that of {frame.image}, "
                f"{shape}, one value per pixel."
            )
    if lens.distortion is not None:
        picture, depth, opaque, matrix = _straightened(
            picture, depth, opaque, lens, str(frame.image)
        )
    if scale < 1:
        height, width = (max(8, round(n * scale)) for n in shape)
        picture = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
        if depth is not None:
            depth = picked(depth, (height, width), (height / shape[0], width / shape[1]))
        if opaque is not None:
            share = opaque.astype(np.float32)
            opaque = cv2.resize(share, (width, height), interpolation=cv2.INTER_AREA) > _OPAQUE
        matrix = matrix.copy()
        for axis, ratio in ((0, width / shape[1]), (1, height / shape[0])):
            matrix[axis, axis] *= ratio
            matrix[axis, 2] = (matrix[axis, 2] + 0.5) * ratio - 0.5
    return Picture(np.clip(picture, 0, 1), matrix, depth, opaque, doubtful)


def _upright(frame: Frame) -> tuple[bool, bool]:
    """Whether to rotate an image by its EXIF orientation, and whether that is doubtful."""
    orientation = image_orientation(frame.image) if frame.image.is_file() else 1
    if orientation == 1:
        return False, False
    turned, stored = (image_size(frame.image, upright=upright) for upright in (True, False))
    if frame.lens.size is not None and turned != stored:
        return frame.lens.size != stored, False
    return frame.upright, True


def _stored_depth(path: Path) -> np.ndarray:
    """Depth as stored: an image, or an array."""
    if path.suffix != ".npy":
        return read_raw(path)
    try:
        found = np.load(path, allow_pickle=False)
    except (OSError, EOFError, ValueError) as fault:
        raise ValueError(f"{path} cannot be read: {fault}; expected an array of depths.") from fault
    if found.dtype.kind not in "fui" or not np.isfinite(found).all():
        raise ValueError(f"{path} must hold finite numbers, 0 where depth is not known.")
    return found


def _outlined(x: np.ndarray, y: np.ndarray) -> float:
    """Area enclosed by the source positions of an image's border, px."""
    border = [np.concatenate([a[0], a[1:, -1], a[-1, -2::-1], a[-2:0:-1, 0]]) for a in (x, y)]
    return cv2.contourArea(np.stack(border, axis=1).astype(np.float32))


def _straightened(
    picture: np.ndarray, depth: np.ndarray | None, opaque: np.ndarray | None, lens: Lens, where: str
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None, np.ndarray]:
    """An undistorted photograph, cropped to valid pixels."""
    height, width = picture.shape[:2]
    size, bent = (width, height), np.asarray(lens.distortion)
    still = np.eye(3)
    if lens.fisheye:
        matrix = cv2.fisheye.estimateNewCameraMatrixForUndistortRectify(
            lens.matrix, bent, size, still, balance=0.0
        )
        maps = cv2.fisheye.initUndistortRectifyMap(
            lens.matrix, bent, still, matrix, size, cv2.CV_32FC1
        )
    else:
        matrix, _ = cv2.getOptimalNewCameraMatrix(lens.matrix, bent, size, 0)
        maps = cv2.initUndistortRectifyMap(lens.matrix, bent, still, matrix, size, cv2.CV_32FC1)
    x, y = maps
    inside = (x >= -0.5) & (x <= width - 0.5) & (y >= -0.5) & (y <= height - 0.5)
    filled, kept = float(inside.mean()), _outlined(x, y) / (width * height)
    narrow = np.isfinite(matrix).all() and min(matrix[0, 0], matrix[1, 1]) > _SHORTEST * width
    if not narrow or filled < _FILLED or kept < _KEPT:
        raise ValueError(
            f"{where} cannot be straightened: with its distortion {bent.tolist()}, a straight "
            f"picture of focal length {matrix[0, 0]:.4g} px would show {100 * kept:.0f} % of it "
            f"and be filled to {100 * filled:.0f} %; undistort it first."
        )
    center = matrix[0, 2], matrix[1, 2]
    pinhole(
        matrix[0, 0], matrix[1, 1], *center, where=f"{where}, straightened,", size=(height, width)
    )
    straight = cv2.remap(picture, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    if depth is not None:
        depth = cv2.remap(depth, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
    if opaque is not None:
        share = opaque.astype(np.float32)
        opaque = cv2.remap(share, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) > _OPAQUE
    return straight, depth, opaque, np.asarray(matrix, np.float64)
