"""Posed photographs in files that contradict themselves: what is wrong is said plainly."""

import struct

import cv2
import numpy as np
import pytest
from datasets.test_photographs import binary
from datasets.walls import change_json, photographs, synthetic_nerf

from mvedge_jax.datasets.exchange import write_colmap, write_nerfstudio
from mvedge_jax.datasets.photographs import load_photographs


@pytest.fixture
def model(tmp_path):
    write_colmap(tmp_path / "model", photographs())
    return tmp_path / "model"


def replaced(name, old, new):
    """Replaces words in a file of a model."""

    def change(folder):
        file = folder / "sparse" / "0" / name
        assert old in file.read_text()
        file.write_text(file.read_text().replace(old, new))

    return change


def heads_only(folder):
    """The places of points are gone."""
    file = folder / "sparse" / "0" / "images.txt"
    heads = [line for line in file.read_text().splitlines() if line.endswith(".png")]
    file.write_text("\n".join(heads) + "\n")


def last_camera_gone(folder):
    file = folder / "sparse" / "0" / "cameras.txt"
    file.write_text("\n".join(file.read_text().splitlines()[:-1]))


def fisheye(numbers):
    """Large photographs through lenses that no plane can show."""

    def change(folder):
        for file in (folder / "images").iterdir():
            cv2.imwrite(str(file), np.zeros((750, 1000, 3), np.uint8))
        lines = [f"{i} OPENCV_FISHEYE 1000 750 {numbers}" for i in range(1, 5)]
        (folder / "sparse" / "0" / "cameras.txt").write_text("\n".join(lines) + "\n")

    return change


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda f: (f / "images" / "b.png").unlink(), r"b\.png is missing"),
        (lambda f: (f / "sparse/0/cameras.txt").unlink(), r"s\.txt is missing; a COLMAP model has"),
        (lambda f: (f / "images").rename(f / "pictures"), "has no folder of images beside it"),
        (
            replaced("cameras.txt", "1 PINHOLE", "1 BANANA"),
            "has the camera model BANANA, which is not handled; expected one of SIMPLE_PINHOLE",
        ),
        (
            replaced("cameras.txt", "PINHOLE 48 36 40", "PINHOLE 48 36 -4"),
            "the intrinsics fx -4, .*expected finite numbers with positive focal lengths",
        ),
        (replaced("cameras.txt", "48 36", "96 72"), r"a\.png has 48x36 px, its camera 96x72"),
        (replaced("cameras.txt", "24 18", "24"), "has 3 fields; expected 4 parameters of PINHOLE"),
        (
            replaced("images.txt", "\n1 ", "\n1 x"),
            "are no numbers; expected numbers of image, pose and camera",
        ),
        (last_camera_gone, r"image d\.png, is of camera 4, which cameras.txt does not hold"),
        (heads_only, r"images.txt, line \d"),
        (replaced("images.txt", "a.png\n", "a.png\n\n\n"), r"images.txt, line \d"),
        (fisheye("330 330 510.5 365.5 -.02 .002 0 0"), "cannot be straightened|far outside of its"),
        (fisheye("300 300 500 375 0 0 0 0"), "cannot be straightened|far outside of its"),
    ],
)
def test_malformed_models(model, change, match):
    change(model)
    kind = FileNotFoundError if "missing" in match or "no folder" in match else ValueError
    with pytest.raises(kind, match=match):
        load_photographs(model)


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_truncated_binaries(model, name):
    file = binary(model) / "sparse" / "0" / f"{name}.bin"
    whole = file.read_bytes()
    parts = [whole[:length] for length in (0, 5, 8, 30, len(whole) // 2, len(whole) - 1)]
    # A count that no file could hold is no reason to ask for memory.
    for part in (*parts, struct.pack("<Q", 2**60) + whole[8:]):
        file.write_bytes(part)
        with pytest.raises(ValueError, match=rf"{name}\.bin is truncated or damaged"):
            load_photographs(model)


def each(**changes):
    """Changes every frame of the transforms."""
    return lambda t: t | {"frames": [f | changes for f in t["frames"]]}


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda t: t | {"frames": []}, "lists 0 frames"),
        (lambda t: {"x": 1}, "has no list `frames`"),
        (lambda t: t | {"camera_model": "EQUIRECTANGULAR"}, "has the camera model 'EQUIRECT"),
        (each(transform_matrix=[[1, 2]]), "has no `transform_matrix` of 4x4 numbers"),
        (each(transform_matrix=np.zeros((4, 4)).tolist()), "has no rotation"),
        (each(fl_x=None), "has no intrinsics; expected fl_x"),
        (lambda t: t | {"depth_unit_scale_factor": None}, "depth_unit_scale_factor = None"),
        (lambda t: t | {"depth_unit_scale_factor": -1}, "depth_unit_scale_factor = -1"),
        (
            lambda t: each(fl_x=None, fl_y=None)({"frames": t["frames"], "camera_angle_x": 0}),
            "camera_angle_x = 0; expected radians",
        ),
    ],
)
def test_malformed_transforms(tmp_path, change, match):
    write_nerfstudio(tmp_path, photographs())
    change_json(tmp_path / "transforms.json", change)
    with pytest.raises(ValueError, match=match):
        load_photographs(tmp_path)


def test_a_folder_without_photographs_or_some_of_them(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="holds no posed photographs; expected a COLMAP model"):
        load_photographs(tmp_path / "empty")
    (tmp_path / "notes.md").write_text("# Notes\n\nNo poses at all.\n")
    with pytest.raises(ValueError, match=r"notes\.md has 1 lines, expected 5 per pose"):
        load_photographs(tmp_path / "notes.md")
    folder = synthetic_nerf(tmp_path / "lego")
    (folder / "train" / "r_2.png").unlink()
    with pytest.raises(FileNotFoundError, match=r"train/r_2 is missing; .*frame 2, names it"):
        load_photographs(folder)
    cv2.imwrite(str(folder / "train" / "r_2.png"), np.zeros((36, 40, 3), np.uint8))
    with pytest.raises(ValueError, match=r"r_2\.png has 40x36 px, the photographs before it 48x36"):
        load_photographs(folder)


def test_depth_and_masks_that_do_not_fit(tmp_path):
    depth = np.ones((36, 48))
    write_nerfstudio(tmp_path, photographs(), depth={1: depth})
    np.save(next((tmp_path / "depths").rglob("*.npy")), np.nan * depth)
    with pytest.raises(ValueError, match="must hold finite numbers"):
        load_photographs(tmp_path)
    with pytest.raises(ValueError, match=r"`mask` must have the shape \(4, 36, 48\)"):
        photographs(mask=np.ones((4, 36, 40), bool))
