"""Posed photographs from files: COLMAP, nerfstudio, lists of poses."""

import os
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mvedge_jax.posed import Photographs

from ._colmap import find_colmap, open_colmap
from ._nerfstudio import TRANSFORMS, open_nerfstudio
from ._picture import read_picture
from ._posed_source import PosedSource, near_origin
from ._sift import triangulated
from ._trajectory import find_trajectory, open_trajectory


def open_photographs(
    path: str | os.PathLike,
    *,
    images: str | os.PathLike | None = None,
    intrinsics: Sequence[float] | None = None,
) -> PosedSource:
    """Recognizes the layout of posed photographs, without reading images.

    Cameras in geographic coordinates are moved to the origin, because float32 would lose their
    distances. `PosedSource.origin` is the offset.

    Args:
        path: a folder with a COLMAP model, a `transforms.json` or `transforms_train.json`, or a
            list of poses, or such a file.
        images: folder of the photographs, if the description names another.
        intrinsics: `(fx, fy, cx, cy)`, px, centers of pixels at integers, for lists of poses
            without a camera file.

    Returns:
        The source.

    Raises:
        FileNotFoundError: `path`, or a file that it names, does not exist.
        ValueError: no known layout, or a malformed one.
    """
    place = None if images is None else Path(images)
    return near_origin(_opened(Path(path), place, intrinsics))


def _opened(path: Path, place: Path | None, intrinsics: Sequence[float] | None) -> PosedSource:
    """The source as its files have it."""
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
    for name in TRANSFORMS:
        if (path / name).is_file():
            return open_nerfstudio(path / name)
    listed = find_trajectory(path)
    if listed is not None:
        return open_trajectory(listed, place, intrinsics)
    raise ValueError(
        f"{path} holds no posed photographs; expected a COLMAP model (cameras.bin or .txt, also in "
        "sparse/0), transforms.json, transforms_train.json, or a list of poses such as "
        "trajectory.log."
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

    Lens distortion is removed. Depth beside the images is read as ground truth. Transparent pixels
    are black and not in the mask. JPEGs are rotated by their EXIF orientation, unless only the
    stored image has the size of its camera.

    Args:
        path: see `open_photographs`.
        images: see there.
        intrinsics: see there.
        names: names of the photographs to load; None for all.
        around: name of a photograph; with `most`, those most useful for its depth are loaded.
        most: largest number of photographs to load, `around` included.
        scale: shrink the photographs by this factor, at most 1.
        points: if the files have no sparse points, triangulate SIFT features with the known poses.

    Returns:
        The photographs. Poses and points are in the unit of the files, and relative to
        `Photographs.origin`; a warning reports an origin other than 0.

    Raises:
        FileNotFoundError: a file is missing.
        ValueError: files are malformed or damaged, photographs differ in size, differ in size from
            their cameras, or are too distorted.

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
    read = []
    for frame in source.frames:
        found = read_picture(frame, source.depth_unit, scale)
        if read and found.image.shape != read[0].image.shape:
            raise ValueError(
                f"{frame.image} has {found.image.shape[1]}x{found.image.shape[0]} px, the "
                f"photographs before it {read[0].image.shape[1]}x{read[0].image.shape[0]}; "
                "expected one size."
            )
        read.append(found)
    pictures, matrices = (np.stack([r[i] for r in read]) for i in (0, 1))
    shape = pictures.shape[1:3]
    truth = _filled([r.depth for r in read], np.zeros(shape, np.float32))
    mask = _filled([r.opaque for r in read], np.ones(shape, bool))
    poses = np.stack([frame.pose for frame in source.frames])
    sparse, observed = source.points, source.observed
    if sparse is None and points:
        sparse, observed = triangulated(pictures, poses, matrices, mask)
    doubtful = [f.image for f, r in zip(source.frames, read, strict=True) if r.doubtful]
    for problem in _doubts(source, Path(path), doubtful):
        warnings.warn(problem, stacklevel=2)
    return Photographs(
        pictures,
        poses,
        matrices,
        points=sparse,
        observed=observed,
        depth=truth,
        mask=mask,
        names=tuple(frame.name for frame in source.frames),
        name=Path(path).resolve().name,
        origin=source.origin,
    )


def _doubts(source: PosedSource, path: Path, turned: list[Path]) -> Iterator[str]:
    """Warnings about the reading of photographs, one sentence each."""
    if any(source.origin):
        yield (
            f"{path} has its cameras far from the origin: the mean of their places, "
            f"({', '.join(f'{x:.9g}' for x in source.origin)}), was subtracted; mvedge export adds "
            "it again."
        )
    if turned:
        more = f" and {len(turned) - 1} more" if len(turned) > 1 else ""
        how = "as viewers show them" if source.frames[0].upright else "as stored, like COLMAP"
        yield (
            f"{turned[0]}{more}: the EXIF orientation asks to turn the image, and the size does "
            f"not tell whether its camera was made for the turned one; read {how}."
        )


def _filled(maps: list[np.ndarray | None], otherwise: np.ndarray) -> np.ndarray | None:
    """Maps of all photographs, if any has one."""
    if all(each is None for each in maps):
        return None
    return np.stack([otherwise if each is None else each for each in maps])


def nearby(source: PosedSource, around: str, most: int | None) -> list[str]:
    """Names of the photographs most useful for the depth of one of them, in their order.

    At most `most`, `around` included: those that share most points with it or, without
    observations, those with the nearest cameras among those of similar direction.
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
        # Views more than 45 degrees off come last.
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
