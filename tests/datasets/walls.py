"""Posed photographs of a slanted wall, and the files that tools keep of them."""

import json
from typing import Any

import numpy as np
from PIL import Image
from posed.walls import MATRIX, POSES, wall

from mvedge_jax.posed import Photographs

IMAGES, DEPTHS = wall(POSES)
BYTES = np.round(255 * IMAGES).astype(np.uint8)
OPENGL = POSES @ np.diag([1.0, -1, -1, 1])
NAMES = ("a.png", "b.png", "c.png", "d.png")
# Corners and middle of the wall, of which the last photograph does not see the first one.
CORNERS = np.array([[-0.5, -0.3, 2.0], [0.5, -0.3, 1.9], [0.1, 0.2, 2.0], [-0.2, 0.25, 2.1]])
OBSERVED = np.ones((4, 4), bool)
OBSERVED[3, 0] = False


def given(value: Any) -> np.ndarray:
    """What may be None, and is not."""
    assert value is not None
    return np.asarray(value)


def photographs(poses=POSES, **changes):
    """The wall from `poses`, with corners that are seen."""
    known = {"points": CORNERS, "observed": OBSERVED, "names": NAMES, **changes}
    return Photographs(BYTES / 255, poses, MATRIX, **known)


def assert_same(found, wanted):
    """Images, cameras and names are the same."""
    np.testing.assert_allclose(found.images, wanted.images, atol=1e-6)
    np.testing.assert_allclose(found.poses, wanted.poses, atol=1e-6)
    np.testing.assert_allclose(found.intrinsics, wanted.intrinsics, atol=1e-5)
    assert found.names == wanted.names


def change_json(file, change):
    """Replaces what a file holds by what `change` makes of it."""
    file.write_text(json.dumps(change(json.loads(file.read_text(encoding="utf-8-sig")))))


def matrices(poses):
    """Lines of numbers, row by row, of every pose."""
    return ["\n".join(" ".join(map(repr, map(float, row))) for row in pose) for pose in poses]


def transforms(names, **changes):
    """What `transforms.json` holds of photographs that are so called."""
    frames = [
        {"file_path": name, "transform_matrix": pose.tolist()}
        for name, pose in zip(names, OPENGL, strict=True)
    ]
    return {"camera_angle_x": 2 * np.arctan(24 / 40), "frames": frames, **changes}


def synthetic_nerf(folder, *, ending=".png", alpha=None, **changes):
    """The layout of NeRF's synthetic scenes; an angle, no size, no ending, `transforms_train`."""
    (folder / "train").mkdir(parents=True)
    for i, image in enumerate(BYTES):
        file = folder / "train" / f"r_{i}{ending}"
        if alpha is None:
            Image.fromarray(image).save(file, quality=100, subsampling=0)
        else:
            Image.fromarray(np.dstack([image, 255 * alpha.astype(np.uint8)])).save(file)
    text = json.dumps(transforms([f"./train/r_{i}" for i in range(4)], **changes))
    (folder / "transforms_train.json").write_text(text, encoding="utf-8-sig")
    return folder
