"""The common form of all descriptions of posed photographs: files, cameras, points."""

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

# Cameras that are this many times as far from the origin as from each other lose more than a part
# in 100,000 of their distances to float32.
_FAR = 100.0


@dataclasses.dataclass(frozen=True)
class Lens:
    """A camera as described in files, pixel centers at integers.

    Attributes:
        size: `(height, width)`, px; None if unknown.
        matrix: intrinsics, px.
        distortion: OpenCV's coefficients; None for none.
        fisheye: whether they are those of OpenCV's fisheye model.
    """

    size: tuple[int, int] | None
    matrix: Float[np.ndarray, "3 3"]
    distortion: tuple[float, ...] | None = None
    fisheye: bool = False


@dataclasses.dataclass(frozen=True)
class Frame:
    """A photograph that is not read yet.

    Attributes:
        name: name of the photograph.
        image: file of the image.
        pose: camera to world; x right, y down, z forward.
        lens: camera of the image.
        depth: file of its true depth, if there is one.
        upright: whether the camera is that of the image rotated by its EXIF orientation, if sizes
            do not decide.
    """

    name: str
    image: Path
    pose: Float[np.ndarray, "4 4"]
    lens: Lens
    depth: Path | None = None
    upright: bool = True


@dataclasses.dataclass(frozen=True)
class PosedSource:
    """A set of posed photographs on disk, opened but not read.

    Attributes:
        layout: the recognized layout, for messages.
        frames: the photographs.
        points: sparse points of the world.
        observed: which photographs observed which points.
        depth_unit: units of the poses per unit of stored depth.
        origin: offset that was subtracted from cameras and points.
    """

    layout: str
    frames: tuple[Frame, ...]
    points: Float[np.ndarray, "m 3"] | None = None
    observed: Bool[np.ndarray, "n m"] | None = None
    depth_unit: float = 1e-3
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)


def near_origin(source: PosedSource) -> PosedSource:
    """Moves cameras in a map's coordinates (UTM, geocentric) to the origin, in float64.

    The mean of the cameras is subtracted from all positions if they are much farther from the
    origin than from each other.
    """
    if not source.frames:
        return source
    centers = np.stack([frame.pose[:3, 3] for frame in source.frames])
    apart = float(np.linalg.norm(centers - centers[0], axis=1).max())
    if not float(np.abs(centers).max()) > _FAR * apart > 0:
        return source
    origin, frames = centers.mean(axis=0), []
    for frame in source.frames:
        pose = frame.pose.copy()
        pose[:3, 3] -= origin
        frames.append(dataclasses.replace(frame, pose=pose))
    x, y, z = origin.tolist()
    points = None if source.points is None else source.points - origin
    return dataclasses.replace(source, frames=tuple(frames), points=points, origin=(x, y, z))


def pinhole(
    fx: float, fy: float, cx: float, cy: float, *, where: str, size: tuple[int, int] | None = None
) -> Float[np.ndarray, "3 3"]:
    """Intrinsics, px, centers at integers, checked; errors begin with `where`.

    Focal lengths must be positive; the principal point may be no farther outside of the frame of a
    `size` than the frame is large.
    """
    values = np.asarray([fx, fy, cx, cy], np.float64)
    if not np.isfinite(values).all() or min(fx, fy) <= 0:
        raise ValueError(
            f"{where} has the intrinsics fx {fx:.6g}, fy {fy:.6g}, cx {cx:.6g}, cy {cy:.6g}; "
            "expected finite numbers with positive focal lengths, in px."
        )
    if size is not None:
        height, width = size
        if not (-width < cx < 2 * width and -height < cy < 2 * height):
            raise ValueError(
                f"{where} has its principal point at ({cx:.6g}, {cy:.6g}), far outside of its "
                f"{width}x{height} px; expected intrinsics of this size of image."
            )
    return np.asarray([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)


def rotation_of(quaternion: Float[np.ndarray, "4"], *, where: str) -> Float[np.ndarray, "3 3"]:
    """The rotation of a quaternion `(w, x, y, z)`, of about unit length: files hold few digits."""
    length = float(np.linalg.norm(quaternion))
    if not 0.9 < length < 1.1:
        raise ValueError(
            f"{where} has a rotation quaternion of length {length:.4g}; expected a unit quaternion."
        )
    # SciPy has the real part last.
    return Rotation.from_quat(np.roll(quaternion, -1)).as_matrix()


def rigid(matrix: Float[np.ndarray, "4 4"], *, where: str) -> Float[np.ndarray, "4 4"]:
    """A pose, camera to world, checked, with its rotation made exact; errors begin with `where`."""
    turn = matrix[:3, :3]
    fault = None
    if not np.isfinite(matrix).all():
        fault = "values that are not finite"
    elif np.abs(turn @ turn.T - np.eye(3)).max() > 1e-2 or np.linalg.det(turn) < 0:
        fault = f"no rotation (determinant {np.linalg.det(turn):.4g})"
    elif np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-6:
        fault = f"the last row {matrix[3].tolist()}"
    if fault:
        raise ValueError(f"{where} has {fault} in its pose; expected a rigid 4x4 matrix.")
    left, _, right = np.linalg.svd(turn)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = left @ right, matrix[:3, 3]
    return pose
