"""Posed photographs as other tools write them: names, sizes, places, cut-outs, orientations."""

import json
import warnings

import jax.numpy as jnp
import numpy as np
import pytest
from datasets.walls import BYTES, CORNERS, matrices, photographs, synthetic_nerf, transforms
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from posed.walls import MATRIX, POSES

from mvedge_jax.datasets.exchange import read_ply, write_colmap, write_nerfstudio
from mvedge_jax.datasets.photographs import load_photographs

# Zone 32 of UTM, and the Earth's center.
PLACES = {"utm": (565_811.3, 5_933_977.8, 31.25), "ecef": (3_739_406.4, 659_412.9, 5_110_563.1)}
Y, X = np.mgrid[:36, :48]
OPAQUE = np.hypot(X - 24, Y - 18) < 14


@pytest.mark.parametrize("ending", [".png", ".JPG", ".jpeg", ".Jpg", ".bmp"])
def test_the_layout_of_nerfs_synthetic_scenes(tmp_path, ending):
    found = load_photographs(synthetic_nerf(tmp_path / "lego", ending=ending), points=False)
    assert_allclose(found.images, BYTES / 255, atol=0.03 if "j" in ending.lower() else 0)
    assert_allclose(found.poses, POSES, atol=1e-6)
    assert_allclose(found.intrinsics[0], MATRIX, rtol=1e-6)
    assert found.names[0] == f"r_0{ending}"
    assert found.mask is None


def test_the_layout_of_instant_ngps_fox(tmp_path):
    (tmp_path / "images").mkdir()
    names = [f"images/000{i}.jpg" for i in range(4)]
    for image, name in zip(BYTES, names, strict=True):
        Image.fromarray(image).save(tmp_path / name, quality=100, subsampling=0)
    top = transforms(names) | {
        "camera_angle_x": 1.08, "camera_angle_y": 0.84, "fl_x": 40.0, "fl_y": 40.0, "k1": 0.0,
        "k2": 0.0, "p1": 0.0, "p2": 0.0, "cx": 24.0, "cy": 18.0, "w": 48.0, "h": 36.0,
        "aabb_scale": 4, "is_fisheye": False,
    }  # fmt: skip
    top["frames"] = [frame | {"sharpness": 30.5} for frame in top["frames"]]
    (tmp_path / "transforms.json").write_text(json.dumps(top))
    found = load_photographs(tmp_path, points=False)
    assert_allclose(found.intrinsics[0], MATRIX, rtol=1e-6)
    assert_allclose(found.images, BYTES / 255, atol=0.03)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_byte_order_marks(tmp_path, encoding):
    folder = synthetic_nerf(tmp_path / "lego")
    file = folder / "transforms_train.json"
    file.write_bytes(file.read_text(encoding="utf-8-sig").encode(encoding))
    assert load_photographs(folder, points=False).names[3] == "r_3.png"
    if encoding == "utf-16":
        return
    write_colmap(tmp_path, photographs())
    for file in (tmp_path / "sparse" / "0").glob("*.txt"):
        file.write_text(file.read_text().split("\n", 1)[1], encoding=encoding)
    assert_allclose(load_photographs(tmp_path).poses, POSES, atol=1e-6)
    rows = "".join(f"{i} {i} 0\n{m}\n" for i, m in enumerate(matrices(POSES)))
    (tmp_path / "images" / "trajectory.log").write_text(rows, encoding=encoding)
    camera = json.dumps({"intrinsic_matrix": MATRIX.T.ravel().tolist()})
    (tmp_path / "images" / "camera.json").write_text(camera, encoding=encoding)
    found = load_photographs(tmp_path / "images", points=False)
    assert_allclose(found.poses, POSES, atol=1e-6)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("write", [write_colmap, write_nerfstudio])
def test_cameras_in_map_coordinates_come_near_and_go_back(tmp_path, place, write):
    origin = PLACES[place]
    write(tmp_path / "far", photographs(origin=origin))
    with pytest.warns(UserWarning, match=r"far has its cameras far from the origin: the mean of"):
        found = load_photographs(tmp_path / "far")
    # Single precision would round the places in the map to half a meter.
    assert found.poses.dtype == jnp.float32
    centers = np.asarray(found.centers, np.float64) + found.origin
    assert_allclose(centers, POSES[:, :3, 3] + origin, atol=1e-6)
    assert found.points is not None
    again = np.asarray(found.points, np.float64) + found.origin
    assert_allclose(again, CORNERS + origin, atol=1e-5)
    write(tmp_path / "again", found)
    with pytest.warns(UserWarning, match="was subtracted; mvedge export adds it again"):
        twice = load_photographs(tmp_path / "again")
    assert_allclose(twice.origin, found.origin, atol=1e-6)
    assert_allclose(twice.poses, found.poses, atol=1e-6)
    if write is write_nerfstudio:
        cloud = read_ply(tmp_path / "again" / "sparse_pc.ply")
        assert_allclose(cloud, CORNERS + origin, atol=1e-5)


def test_transparent_pixels_are_masked(tmp_path):
    def mask(name, alpha, **changes):
        folder = synthetic_nerf(tmp_path / name, alpha=alpha, **changes)
        return load_photographs(folder, points=False).mask

    found = load_photographs(synthetic_nerf(tmp_path / "cut", alpha=OPAQUE), points=False)
    assert_array_equal(found.mask, np.stack([OPAQUE] * 4))
    # Whatever colors are stored there.
    assert_allclose(found.images, BYTES / 255 * OPAQUE[..., None], atol=1e-6)
    half = load_photographs(tmp_path / "cut", points=False, scale=0.5).mask
    assert half is not None
    assert_array_equal(half[0], OPAQUE.reshape(18, 2, 24, 2).all((1, 3)))
    bent = mask("bent", OPAQUE, k1=-0.05)
    assert bent is not None
    assert 0 < int(bent[0].sum()) < OPAQUE.size
    assert mask("whole", np.ones((36, 48), bool)) is None
    # No feature of the outline becomes a point.
    seen = load_photographs(tmp_path / "cut").points
    assert seen is None or np.isfinite(np.asarray(seen)).all()


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
    size = {"w": 48, "h": 36} if sized else {}
    text = json.dumps(transforms([f"{i}.jpg" for i in range(4)], **size))
    (tmp_path / "transforms.json").write_text(text)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = load_photographs(tmp_path, points=False)
    assert_allclose(found.images, BYTES / 255, atol=0.03)
    assert_allclose(found.intrinsics[0], MATRIX, rtol=1e-6)
    told = [str(each.message) for each in said]
    assert len(told) == (orientation == 3), told
    assert all("0.jpg and 3 more: the EXIF orientation asks" in text for text in told)


def test_colmap_reads_images_as_they_are_stored(tmp_path):
    names = tuple(f"{i}.jpg" for i in range(4))
    for orientation in (3, 6):
        write_colmap(tmp_path / str(orientation), photographs(names=names))
        turned(tmp_path / str(orientation) / "images", orientation)
    with pytest.warns(UserWarning, match="made for the turned one; read as stored, like COL"):
        images = load_photographs(tmp_path / "3", points=False).images
    assert_allclose(images, BYTES[:, ::-1, ::-1] / 255, atol=0.03)
    # The model was made from what viewers show: only its size can tell.
    assert_allclose(load_photographs(tmp_path / "6", points=False).images, BYTES / 255, atol=0.03)
