"""Light fields that commands are tried on."""

import json

import numpy as np
from datasets.layouts import write_hci
from posed.walls import MATRIX, POSES, wall
from scipy import ndimage

from mvedge_jax.datasets import write_pfm
from mvedge_jax.datasets.exchange import write_colmap
from mvedge_jax.posed import Photographs

# That of the files of `write_hci`, so that commands which take their range share a program with
# those that are told it.
RANGE = ("--range", "-1.5", "1.25")


def textured_plane(height=32, width=40, *, disparity=0.4, seed=0, grid=(3, 3)) -> np.ndarray:
    """Views of a textured plane, in 8 bits."""
    rng = np.random.default_rng(seed)
    grain = rng.uniform(size=(height + 20, width + 20, 3))
    texture = ndimage.gaussian_filter(grain, (0.9, 0.9, 0)) * 2 - 0.5
    y, x = np.mgrid[0:height, 0:width].astype(float) + 10
    views = np.zeros((*grid, height, width, 3))
    for v, u in np.ndindex(*grid):
        place = [y - (grid[0] // 2 - v) * disparity, x - (grid[1] // 2 - u) * disparity]
        for c in range(3):
            views[v, u, ..., c] = ndimage.map_coordinates(texture[..., c], place, order=3)
    return np.round(255 * np.clip(views, 0, 1)).astype(np.uint8)


def write_plane(folder, height=32, width=40, *, disparity=0.4, seed=0):
    """Such a plane in the HCI layout, with its truth."""
    views = textured_plane(height, width, disparity=disparity, seed=seed)
    truth = np.full((height, width), disparity, np.float32)
    return write_hci(folder, views, disparity=truth)


def gray_scenes(folder, names):
    """Light fields of 8x8 px of one gray at disparity 0: no command looks at what they show."""
    views = np.full((3, 3, 8, 8, 3), 128, np.uint8)
    truth = np.zeros((8, 8), np.float32)
    return [write_hci(folder / name, views, disparity=truth) for name in names]


def write_result(folder, scene, disparity, *, xy=None, error=0.01):
    """What `mvedge depth` writes of a scene: a map of one error, and points on it."""
    folder.mkdir()
    source = {"path": str(scene), "views": None, "scale": 1.0, "flip_u": False, "flip_v": False}
    (folder / "report.json").write_text(json.dumps({"source": source}))
    (folder / ".mvedge.json").write_text(json.dumps({"program": "mvedge_jax", "written": []}))
    disparity = np.asarray(disparity, np.float32)
    write_pfm(folder / "disparity.pfm", disparity)
    write_pfm(folder / "standard_error.pfm", np.full_like(disparity, error))
    if xy is not None:
        on_map = disparity[tuple(xy.T[::-1].astype(int))]
        columns = {"error": np.full(len(xy), error), "visible": np.ones((len(xy), 6), bool)}
        np.savez(folder / "points.npz", xy=xy, disparity=on_map, **columns)
    return folder


def write_wall(folder):
    """Four photographs of a wall, a model of COLMAP; and their depth."""
    images, depths = wall(POSES)
    names = tuple(f"{i}.png" for i in range(4))
    write_colmap(folder, Photographs(images.astype(np.float32), POSES, MATRIX, names=names))
    return folder, depths.astype(np.float32)


def write_stereo_result(folder, model, depths, photographs):
    """What `mvedge stereo` writes of some of the photographs of a model."""
    folder.mkdir()
    for name in photographs:
        stem = name.partition(".")[0]
        write_pfm(folder / f"{stem}_depth.pfm", depths[int(stem)])
        write_pfm(folder / f"{stem}_error.pfm", 0.01 * depths[int(stem)])
    rows = dict.fromkeys(photographs, {"baseline": 0.2})
    report = {"command": "stereo", "model": str(model), "method": "dense", "scale": 1.0}
    report |= {"images": None, "intrinsics": None, "photographs": rows}
    (folder / "report.json").write_text(json.dumps(report))
    (folder / ".mvedge.json").write_text("{}")
    return folder
