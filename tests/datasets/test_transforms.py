"""Posed photographs as other tools write them: names, sizes, places, cut-outs, orientations."""

import json
import warnings

import cv2
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image
from posed.walls import MATRIX, POSES, wall

from mvedge_jax.datasets.exchange import read_ply, write_colmap, write_nerfstudio
from mvedge_jax.datasets.photographs import load_photographs
from mvedge_jax.posed import Photographs

IMAGES, DEPTHS = wall(POSES)
BYTES = np.round(255 * IMAGES).astype(np.uint8)
OPENGL = POSES @ np.diag([1.0, -1, -1, 1])
CORNERS = np.array([[-0.5, -0.3, 2.0], [0.5, -0.3, 1.9], [0.1, 0.2, 2.0], [-0.2, 0.25, 2.1]])
# Zone 32 of UTM, and the Earth's centre.
PLACES = {"utm": (565_811.3, 5_933_977.8, 31.25), "ecef": (3_739_406.4, 659_412.9, 5_110_563.1)}


def opaque() -> np.ndarray:
    y, x = np.mgrid[:36, :48]
    return np.hypot(x - 24, y - 18) < 14


def synthetic_nerf(folder, *, ending=".png", alpha=None, **changes):
    """The layout of NeRF's synthetic scenes; an angle, no size, no ending, `transforms_train`."""
    (folder / "train").mkdir(parents=True)
    frames = []
    for i, (image, pose) in enumerate(zip(BYTES, OPENGL, strict=True)):
        file = folder / "train" / f"r_{i}{ending}"
        if alpha is None:
            Image.fromarray(image).save(file, quality=100, subsampling=0)
        else:
            Image.fromarray(np.dstack([image, 255 * alpha.astype(np.uint8)])).save(file)
        frames.append(
            {"file_path": f"./train/r_{i}", "rotation": 0.01, "transform_matrix": pose.tolist()}
        )
    top = {"camera_angle_x": 2 * np.arctan(24 / 40), "frames": frames, **changes}
    (folder / "transforms_train.json").write_text(json.dumps(top), encoding="utf-8-sig")
    return folder


@pytest.mark.parametrize("ending", [".png", ".JPG", ".jpeg", ".Jpg", ".bmp"])
def test_the_layout_of_nerfs_synthetic_scenes(tmp_path, ending):
    found = load_photographs(synthetic_nerf(tmp_path / "lego", ending=ending), points=False)
    np.testing.assert_allclose(found.images, BYTES / 255, atol=0.03 if "j" in ending.lower() else 0)
    np.testing.assert_allclose(found.poses, POSES, atol=1e-6)
    np.testing.assert_allclose(found.intrinsics[0], MATRIX, rtol=1e-6)
    assert found.names[0] == f"r_0{ending}"
    assert found.mask is None


def test_the_layout_of_instant_ngps_fox(tmp_path):
    (tmp_path / "images").mkdir()
    frames = []
    for i, pose in enumerate(OPENGL):
        Image.fromarray(BYTES[i]).save(
            tmp_path / "images" / f"000{i}.jpg", quality=100, subsampling=0
        )
        path = {"file_path": f"images/000{i}.jpg", "sharpness": 30.5}
        frames.append(path | {"transform_matrix": pose.tolist()})
    top = {
        "camera_angle_x": 1.08, "camera_angle_y": 0.84, "fl_x": 40.0, "fl_y": 40.0, "k1": 0.0,
        "k2": 0.0, "p1": 0.0, "p2": 0.0, "cx": 24.0, "cy": 18.0, "w": 48.0, "h": 36.0,
        "aabb_scale": 4, "is_fisheye": False, "frames": frames,
    }  # fmt: skip
    (tmp_path / "transforms.json").write_text(json.dumps(top))
    found = load_photographs(tmp_path, points=False)
    np.testing.assert_allclose(found.intrinsics[0], MATRIX, rtol=1e-6)
    np.testing.assert_allclose(found.images, BYTES / 255, atol=0.03)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_byte_order_marks(tmp_path, encoding):
    folder = synthetic_nerf(tmp_path)
    file = folder / "transforms_train.json"
    file.write_bytes(file.read_text(encoding="utf-8-sig").encode(encoding))
    assert load_photographs(folder, points=False).names[3] == "r_3.png"


def test_byte_order_marks_of_the_other_forms(tmp_path):
    write_colmap(tmp_path, photographs())
    for file in (tmp_path / "sparse" / "0").glob("*.txt"):
        file.write_text(file.read_text().split("\n", 1)[1], encoding="utf-8-sig")
    np.testing.assert_allclose(load_photographs(tmp_path).poses, POSES, atol=1e-6)
    listed = tmp_path / "images" / "trajectory.log"
    rows = (f"{i} {i} 0\n" + "\n".join(" ".join(map(str, r)) for r in p) + "\n"
            for i, p in enumerate(POSES))  # fmt: skip
    listed.write_text("".join(rows), encoding="utf-8-sig")
    camera = {"intrinsic_matrix": MATRIX.T.ravel().tolist()}
    listed.with_name("camera.json").write_text(json.dumps(camera), encoding="utf-8-sig")
    found = load_photographs(tmp_path / "images", points=False)
    np.testing.assert_allclose(found.poses, POSES, atol=1e-6)


def photographs(**changes):
    known = {"points": CORNERS, "observed": np.ones((4, 4), bool), **changes}
    names = ("a.png", "b.png", "c.png", "d.png")
    return Photographs(jnp.asarray(BYTES / 255, jnp.float32), POSES, MATRIX, names=names, **known)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("write", [write_colmap, write_nerfstudio])
def test_cameras_in_map_coordinates_come_near_and_go_back(tmp_path, place, write):
    origin = PLACES[place]
    write(tmp_path / "far", photographs(origin=origin))
    with pytest.warns(UserWarning, match=r"far has its cameras far from the origin: the mean of"):
        found = load_photographs(tmp_path / "far")
    # Single precision would round the places in the map to half a metre.
    assert found.poses.dtype == jnp.float32
    centres = np.asarray(found.centres, np.float64) + found.origin
    np.testing.assert_allclose(centres, POSES[:, :3, 3] + origin, atol=1e-6)
    assert found.points is not None
    again = np.asarray(found.points, np.float64) + found.origin
    np.testing.assert_allclose(again, CORNERS + origin, atol=1e-5)
    write(tmp_path / "again", found)
    with pytest.warns(UserWarning, match="was subtracted; mvedge export adds it again"):
        twice = load_photographs(tmp_path / "again")
    np.testing.assert_allclose(twice.origin, found.origin, atol=1e-6)
    np.testing.assert_allclose(twice.poses, found.poses, atol=1e-6)
    if write is write_nerfstudio:
        cloud = read_ply(tmp_path / "again" / "sparse_pc.ply")
        np.testing.assert_allclose(cloud, CORNERS + origin, atol=1e-5)


def test_cameras_near_their_origin_stay_where_they_are(tmp_path):
    write_colmap(tmp_path, photographs())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = load_photographs(tmp_path)
    assert found.origin == (0, 0, 0)
    np.testing.assert_array_equal(found.poses[0], np.eye(4))


def test_the_errors_of_exported_points_are_not_known(tmp_path):
    write_colmap(tmp_path, photographs())
    rows = (tmp_path / "sparse" / "0" / "points3D.txt").read_text().splitlines()[1:]
    assert [row.split()[7] for row in rows] == ["-1"] * 4


def test_transparent_pixels_are_masked(tmp_path):
    folder = synthetic_nerf(tmp_path / "cut", alpha=opaque())
    found = load_photographs(folder, points=False)
    assert found.mask is not None
    np.testing.assert_array_equal(found.mask, np.stack([opaque()] * 4))
    # Whatever colors are stored there.
    np.testing.assert_allclose(found.images, BYTES / 255 * opaque()[..., None], atol=1e-6)
    half = load_photographs(folder, points=False, scale=0.5)
    assert half.mask is not None
    whole = opaque().reshape(18, 2, 24, 2).all((1, 3))
    np.testing.assert_array_equal(half.mask[0], whole)
    bent = synthetic_nerf(tmp_path / "bent", alpha=opaque(), k1=-0.05)
    mask = load_photographs(bent, points=False).mask
    assert mask is not None
    assert 0 < int(mask[0].sum()) < opaque().size
    whole = synthetic_nerf(tmp_path / "whole", alpha=np.ones((36, 48), bool))
    assert load_photographs(whole, points=False).mask is None
    # No feature of the outline becomes a point.
    seen = load_photographs(folder).points
    assert seen is None or np.isfinite(np.asarray(seen)).all()
    with pytest.raises(ValueError, match=r"`mask` must have the shape \(4, 36, 48\)"):
        photographs(mask=np.ones((4, 36, 40), bool))


def turned(folder, orientation):
    """The photographs stored as a camera on its side stores them."""
    back = {3: Image.Transpose.ROTATE_180, 6: Image.Transpose.ROTATE_90}[orientation]
    exif = Image.Exif()
    exif[0x112] = orientation
    for i, image in enumerate(BYTES):
        stored = Image.fromarray(image).transpose(back)
        stored.save(folder / f"{i}.jpg", quality=100, subsampling=0, exif=exif)


@pytest.mark.parametrize("sized", [False, True])
@pytest.mark.parametrize("orientation", [3, 6])
def test_exif_orientations_of_transforms(tmp_path, orientation, sized):
    turned(tmp_path, orientation)
    frames = [{"file_path": f"{i}.jpg", "transform_matrix": pose.tolist()}
              for i, pose in enumerate(OPENGL)]  # fmt: skip
    top = {"camera_angle_x": 2 * np.arctan(24 / 40), "frames": frames}
    top |= {"w": 48, "h": 36} if sized else {}
    (tmp_path / "transforms.json").write_text(json.dumps(top))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = load_photographs(tmp_path, points=False)
    np.testing.assert_allclose(found.images, BYTES / 255, atol=0.03)
    np.testing.assert_allclose(found.intrinsics[0], MATRIX, rtol=1e-6)
    told = [str(each.message) for each in said]
    assert len(told) == (orientation == 3), told
    assert all("0.jpg and 3 more: the EXIF orientation asks" in text for text in told)


def test_colmap_reads_images_as_they_are_stored(tmp_path):
    names = tuple(f"{i}.jpg" for i in range(4))
    for orientation in (3, 6):
        folder = tmp_path / str(orientation)
        write_colmap(folder, Photographs(BYTES / 255, POSES, MATRIX, names=names))
        turned(folder / "images", orientation)
        if orientation == 6:
            # The model was made from what viewers show: only its size can tell.
            images = load_photographs(folder, points=False).images
            np.testing.assert_allclose(images, BYTES / 255, atol=0.03)
            continue
        with pytest.warns(UserWarning, match="made for the turned one; read as stored, like COL"):
            images = load_photographs(folder, points=False).images
        np.testing.assert_allclose(images, BYTES[:, ::-1, ::-1] / 255, atol=0.03)


def test_a_folder_of_transforms_without_images_names_them(tmp_path):
    folder = synthetic_nerf(tmp_path)
    (folder / "train" / "r_2.png").unlink()
    with pytest.raises(FileNotFoundError, match=r"train/r_2 is missing; .*frame 2, names it"):
        load_photographs(folder)
    cv2.imwrite(str(folder / "train" / "r_2.png"), np.zeros((36, 40, 3), np.uint8))
    with pytest.raises(ValueError, match=r"r_2\.png has 40x36 px, the photographs before it 48x36"):
        load_photographs(folder)
