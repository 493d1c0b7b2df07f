"""Posed photographs from files: COLMAP, nerfstudio, lists of poses."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from mvedge_jax.posed import Photographs

from .._images import picked, read_image, read_raw
from ._colmap import find_colmap, open_colmap
from ._nerfstudio import open_nerfstudio
from ._posed_source import Frame, Lens, PosedSource, pinhole
from ._sift import triangulated
from ._trajectory import find_trajectory, open_trajectory

# Share of a photograph that must be left where lens distortion is taken out, share of the frame
# that it must fill, and the least focal length, as a share of the frame, 168 degrees wide.
_KEPT, _FILLED, _SHORTEST = 0.3, 0.98, 0.05


def open_photographs(
    path: str | os.PathLike,
    *,
    images: str | os.PathLike | None = None,
    intrinsics: Sequence[float] | None = None,
) -> PosedSource:
    """Finds out what a set of posed photographs is, without reading its images.

    Args:
        path: a folder with a COLMAP model, a `transforms.json` or a list of poses, or such a file.
        images: folder of the photographs, where it is not where the description says.
        intrinsics: `(fx, fy, cx, cy)`, px, centres of pixels at integers, for lists of poses
            without a camera file.

    Returns:
        The source.

    Raises:
        FileNotFoundError: `path` does not exist, or something that it names.
        ValueError: no known layout, or a malformed one.
    """
    path = Path(path)
    place = None if images is None else Path(images)
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist.")
    if place is not None and not place.is_dir():
        raise FileNotFoundError(f"{place} is no folder; expected that of the photographs.")
    if path.is_file():
        if path.suffix == ".json":
            return open_nerfstudio(path)
        return open_trajectory(path, place, intrinsics)
    colmap = find_colmap(path)
    if colmap is not None:
        return open_colmap(colmap, place)
    if (path / "transforms.json").is_file():
        return open_nerfstudio(path / "transforms.json")
    listed = find_trajectory(path)
    if listed is not None:
        return open_trajectory(listed, place, intrinsics)
    raise ValueError(
        f"{path} holds no posed photographs; expected a COLMAP model (cameras.bin or .txt, also in "
        "sparse/0), transforms.json, or a list of poses such as trajectory.log."
    )


def load_photographs(
    path: str | os.PathLike,
    *,
    images: str | os.PathLike | None = None,
    intrinsics: Sequence[float] | None = None,
    names: Sequence[str] | None = None,
    around: str | None = None,
    most: int | None = None,
    scale: float = 1.0,
    points: bool = True,
) -> Photographs:
    """Loads posed photographs: a COLMAP model, `transforms.json`, or images and a list of poses.

    Lens distortion is taken out. Depth beside the images is read as ground truth.

    Args:
        path: see `open_photographs`.
        images: see there.
        intrinsics: see there.
        names: of the photographs to load; None for all.
        around: name of a photograph; with `most`, those are loaded that know most about its depth.
        most: how many photographs to load at most, `around` itself included.
        scale: shrink the photographs by this factor, at most 1.
        points: where the files hold no sparse points, find some: SIFT features, matched and
            triangulated with the known poses.

    Returns:
        The photographs. Poses and points are in the unit of the files.

    Raises:
        FileNotFoundError: a file is missing.
        ValueError: files are malformed or damaged, photographs differ in size, have another size
            than their cameras say, or are bent too much.

    Example:
        >>> load_photographs("nowhere")
        Traceback (most recent call last):
        FileNotFoundError: nowhere does not exist.
    """
    if not 0 < scale <= 1:
        raise ValueError(f"`scale` must be above 0 and at most 1, got {scale}.")
    source = open_photographs(path, images=images, intrinsics=intrinsics)
    if around is not None and names is None:
        names = nearby(source, around, most)
    source = _chosen(source, names, Path(path))
    if len(source.frames) < 2:
        raise ValueError(f"`names` must be at least two photographs, got {list(names or ())}.")
    pictures, matrices, depths = [], [], []
    for frame in source.frames:
        picture, matrix, depth = _read(frame, source.depth_unit, scale)
        if pictures and picture.shape != pictures[0].shape:
            raise ValueError(
                f"{frame.image} has {picture.shape[1]}x{picture.shape[0]} px, the photographs "
                f"before it {pictures[0].shape[1]}x{pictures[0].shape[0]}; expected one size."
            )
        pictures.append(picture)
        matrices.append(matrix)
        depths.append(depth)
    known = [depth is not None for depth in depths]
    truth = None
    if any(known):
        shape = pictures[0].shape[:2]
        truth = np.stack([np.zeros(shape, np.float32) if d is None else d for d in depths])
    poses = np.stack([frame.pose for frame in source.frames])
    sparse, observed = source.points, source.observed
    if sparse is None and points:
        sparse, observed = triangulated(np.stack(pictures), poses, np.stack(matrices))
    return Photographs(
        np.stack(pictures),
        poses,
        np.stack(matrices),
        points=sparse,
        observed=observed,
        depth=truth,
        names=tuple(frame.name for frame in source.frames),
        name=Path(path).resolve().name,
    )


def with_points(photographs: Photographs) -> Photographs:
    """Photographs with sparse points made on the spot.

    Args:
        photographs: with known poses.

    Returns:
        The same with points: SIFT features, matched and triangulated with the poses.
    """
    poses, matrices = (
        np.asarray(values, np.float64) for values in (photographs.poses, photographs.intrinsics)
    )
    points, observed = triangulated(np.asarray(photographs.images), poses, matrices)
    return Photographs(
        photographs.images,
        photographs.poses,
        photographs.intrinsics,
        points=points,
        observed=observed,
        depth=photographs.depth,
        names=photographs.names,
        name=photographs.name,
    )


def nearby(source: PosedSource, around: str, most: int | None) -> list[str]:
    """The photographs that know most about the depth of one of them.

    Args:
        source: see `open_photographs`.
        around: name of the photograph, with or without its ending.
        most: how many, itself included; None for all.

    Returns:
        Names, in the order of the source: those that share most points with it, or, where it is
        not known to see any, those whose cameras are nearest among the ones that look the same way.

    Raises:
        ValueError: there is no such photograph, or `most` is below 2.
    """
    known = [frame.name for frame in source.frames]
    own = _index(known, around, Path(source.layout))
    if most is None or most >= len(known):
        return known
    if most < 2:
        raise ValueError(f"`most` must be at least 2, got {most}.")
    poses = np.stack([frame.pose for frame in source.frames])
    if source.observed is not None and bool(source.observed[own].any()):
        rank = -(source.observed & source.observed[own]).sum(axis=1).astype(float)
    else:
        rank = np.linalg.norm(poses[:, :3, 3] - poses[own, :3, 3], axis=1)
        # Views that look elsewhere, more than 45 degrees off, come last.
        rank = rank + np.where(poses[:, :3, 2] @ poses[own, :3, 2] < 0.7, 1e6 * rank.max(), 0)
    rank[own] = -np.inf
    return [known[i] for i in sorted(np.argsort(rank, kind="stable")[:most])]


def _index(known: list[str], name: str, where: Path) -> int:
    if name in known:
        return known.index(name)
    stems = [own.rsplit(".", 1)[0] for own in known]
    if stems.count(name) == 1:
        return stems.index(name)
    some = ", ".join(known[:8]) + (", ..." if len(known) > 8 else "")
    raise ValueError(f"{where} has no photograph called {name!r}; there are {some}.")


def _chosen(source: PosedSource, names: Sequence[str] | None, path: Path) -> PosedSource:
    if names is None:
        return source
    known = [frame.name for frame in source.frames]
    picked = [_index(known, name, path) for name in names]
    observed = None if source.observed is None else source.observed[picked]
    points = source.points
    if observed is not None and points is not None:
        kept = observed.any(axis=0)
        points, observed = points[kept], observed[:, kept]
    return replace(
        source, frames=tuple(source.frames[i] for i in picked), points=points, observed=observed
    )


def _read(
    frame: Frame, depth_unit: float, scale: float
) -> tuple[Float[np.ndarray, "y x 3"], Float[np.ndarray, "3 3"], np.ndarray | None]:
    """A photograph without distortion, its intrinsics, and its true depth or None."""
    stored = read_image(frame.image)
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
    depth = None
    if frame.depth is not None:
        depth = _stored_depth(frame.depth).astype(np.float32) * np.float32(depth_unit)
        if depth.shape != shape:
            raise ValueError(
                f"{frame.depth} has the shape {depth.shape}; expected that of {frame.image}, "
                f"{shape}, one value per pixel."
            )
    if lens.distortion is not None:
        picture, depth, matrix = _straightened(picture, depth, lens, str(frame.image))
    if scale < 1:
        height, width = (max(8, round(n * scale)) for n in shape)
        picture = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
        if depth is not None:
            depth = picked(depth, (height, width), (height / shape[0], width / shape[1]))
        matrix = matrix.copy()
        for axis, ratio in ((0, width / shape[1]), (1, height / shape[0])):
            matrix[axis, axis] *= ratio
            matrix[axis, 2] = (matrix[axis, 2] + 0.5) * ratio - 0.5
    return np.clip(picture, 0, 1), matrix, depth


def _stored_depth(path: Path) -> np.ndarray:
    """Depth as files hold it: an image, or an array."""
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
    """Area inside of where the border of an image comes from, px."""

    def border(a: np.ndarray) -> np.ndarray:
        return np.concatenate([a[0], a[1:, -1], a[-1, -2::-1], a[-2:0:-1, 0]]).astype(np.float64)

    a, b = border(x), border(y)
    return 0.5 * abs(float(np.sum(a * np.roll(b, -1) - np.roll(a, -1) * b)))


def _straightened(
    picture: np.ndarray, depth: np.ndarray | None, lens: Lens, where: str
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
    """A photograph without lens distortion, all of it inside of what was photographed."""
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
    centre = matrix[0, 2], matrix[1, 2]
    pinhole(
        matrix[0, 0], matrix[1, 1], *centre, where=f"{where}, straightened,", size=(height, width)
    )
    straight = cv2.remap(picture, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    if depth is not None:
        depth = cv2.remap(depth, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
    return straight, depth, np.asarray(matrix, np.float64)
