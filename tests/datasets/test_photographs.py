"""Posed photographs from files: every form says the same."""

import json
import struct

import cv2
import jax.numpy as jnp
import numpy as np
import pytest
from datasets.walls import (
    BYTES,
    CORNERS,
    DEPTHS,
    IMAGES,
    OBSERVED,
    assert_same,
    change_json,
    given,
    matrices,
    photographs,
)
from helpers import shared_data
from numpy.testing import assert_allclose, assert_array_equal
from posed.walls import MATRIX, POSES, wall
from scipy.spatial.transform import Rotation

from mvedge_jax.datasets.exchange import read_ply, write_colmap, write_nerfstudio, write_ply
from mvedge_jax.datasets.photographs import load_photographs
from mvedge_jax.datasets.photographs._photographs import nearby, open_photographs
from mvedge_jax.datasets.photographs._sift import triangulated
from mvedge_jax.posed import Photographs


@pytest.fixture
def model(tmp_path):
    write_colmap(tmp_path / "model", photographs())
    return tmp_path / "model"


def binary(folder):
    """The model of `folder` in binary form, written by the letter of COLMAP's description."""
    sparse = folder / "sparse" / "0"

    def rows(name):
        file = sparse / f"{name}.txt"
        lines = file.read_text().splitlines()[1:]
        file.unlink()
        return [line.split() for line in lines]

    cameras, images, points = map(rows, ("cameras", "images", "points3D"))
    data = struct.pack("<Q", len(cameras))
    for number, _, width, height, *values in cameras:
        data += struct.pack("<iiQQ4d", int(number), 1, int(width), int(height), *map(float, values))
    (sparse / "cameras.bin").write_bytes(data)
    data = struct.pack("<Q", len(images) // 2)
    for (number, *pose, camera, name), words in zip(images[::2], images[1::2], strict=True):
        data += struct.pack("<i7di", int(number), *map(float, pose), int(camera))
        data += name.encode() + b"\0" + struct.pack("<Q", len(words) // 3)
        for x, y, point in zip(words[::3], words[1::3], words[2::3], strict=True):
            data += struct.pack("<ddq", float(x), float(y), int(point))
    (sparse / "images.bin").write_bytes(data)
    data = struct.pack("<Q", len(points))
    for number, x, y, z, r, g, b, error, *track in points:
        data += struct.pack("<Q3d", int(number), *map(float, (x, y, z)))
        data += struct.pack("<3Bd", *map(int, (r, g, b)), float(error))
        data += struct.pack(f"<Q{len(track)}i", len(track) // 2, *map(int, track))
    (sparse / "points3D.bin").write_bytes(data)
    return folder


def test_colmap_text_and_binary_say_the_same(model):
    rows = (model / "sparse" / "0" / "points3D.txt").read_text().splitlines()[1:]
    assert [row.split()[7] for row in rows] == ["-1"] * 4, "errors of points are not known"
    text = load_photographs(model)
    assert_same(text, photographs())
    assert text.origin == (0, 0, 0)
    assert_allclose(given(text.points), CORNERS, atol=1e-6)
    assert_array_equal(text.observed, OBSERVED)
    again = load_photographs(binary(model))
    assert_same(again, text)
    assert_array_equal(again.points, text.points)
    assert_array_equal(again.observed, text.observed)


def test_pycolmap_reads_what_we_write_and_we_what_it_writes(model, tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    stored = pycolmap.Reconstruction(str(model / "sparse" / "0"))
    assert len(stored.images) == 4
    assert len(stored.points3D) == 4
    for image in stored.images.values():
        pose = POSES["abcd".index(image.name[0])]
        assert_allclose(image.projection_center(), pose[:3, 3], atol=1e-6)
        camera = stored.cameras[image.camera_id]
        for k, point in stored.points3D.items():
            # COLMAP's pixel centers are at .5, ours at integers.
            place = camera.img_from_cam(image.cam_from_world() * point.xyz)
            local = pose[:3, :3].T @ (CORNERS[k - 1] - pose[:3, 3])
            assert_allclose(place - 0.5, (MATRIX @ local)[:2] / local[2], atol=1e-5)
    for form in ("text", "binary"):
        folder = tmp_path / form
        (folder / "sparse").mkdir(parents=True)
        getattr(stored, f"write_{form}")(str(folder / "sparse"))
        again = load_photographs(folder, images=model / "images")
        assert_same(again, photographs())
        assert_array_equal(np.sort(given(again.observed).sum(0)), np.sort(OBSERVED.sum(0)))


@pytest.mark.parametrize(
    "rotations", [Rotation.random(4, np.random.default_rng(0)), Rotation.from_quat(np.eye(4))]
)
def test_any_rotation_comes_back(tmp_path, rotations):
    poses = POSES.copy()
    poses[:, :3, :3] = rotations.as_matrix()
    write_colmap(tmp_path, photographs(poses))
    assert_allclose(load_photographs(tmp_path, points=False).poses, poses, atol=1e-6)


def test_nerfstudio_comes_back(tmp_path):
    depth = DEPTHS[1].copy()
    depth[0, :3] = 2e6, np.inf, 0
    write_nerfstudio(tmp_path, photographs(), depth={1: depth})
    loaded = load_photographs(tmp_path)
    assert_same(loaded, photographs())
    assert_allclose(given(loaded.points), CORNERS, atol=1e-6)
    assert float(given(loaded.depth)[0].max()) == 0
    # Far pixels leave the others their depth.
    found = given(loaded.depth)[1]
    assert_allclose(found[1:], DEPTHS[1][1:], rtol=1e-6)
    assert_allclose(found[0, :3], [2e6, 0, 0])
    frames = json.loads((tmp_path / "transforms.json").read_text())["frames"]
    # What nerfstudio makes of it with its defaults, whatever the file says.
    assert_allclose(1e-3 * np.load(tmp_path / frames[1]["depth_file_path"]), found)
    assert frames[1]["mask_path"] == "masks/b.png.png"
    mask = given(cv2.imread(str(tmp_path / frames[1]["mask_path"]), cv2.IMREAD_UNCHANGED))
    assert_array_equal(mask, 255 * (found > 0))
    # OpenGL's camera looks along its negative z axis.
    assert_allclose(-np.array(frames[2]["transform_matrix"])[:3, 2], POSES[2, :3, 2])


def save_all(folder, name):
    names = tuple(map(name.format, range(4)))
    for file, image in zip(names, BYTES, strict=True):
        assert cv2.imwrite(str(folder / file), image[..., ::-1])
    return names


LENS = (40.0, 40.0, 23.5, 17.5)


def write_log(folder, poses):
    rows = (f"{i} {i} {i + 1}\n{m}\n" for i, m in enumerate(matrices(poses)))
    (folder / "trajectory.log").write_text("".join(rows))


def test_lists_of_poses(tmp_path):
    names = save_all(tmp_path, "0{}.png")
    write_log(tmp_path, POSES)
    found = load_photographs(tmp_path, intrinsics=LENS, points=False)
    assert_same(found, photographs(names=names))
    with pytest.raises(ValueError, match="does not say its camera's intrinsics; give"):
        load_photographs(tmp_path)
    timed = tmp_path / "timed"
    timed.mkdir()
    names = save_all(timed, "{}.500.png")
    turns = Rotation.from_matrix(POSES[:, :3, :3]).as_quat()
    rows = np.column_stack([np.arange(4) + 0.51, POSES[:, :3, 3], turns])
    np.savetxt(timed / "groundtruth.txt", rows, header="time and pose")
    (timed / "camera.txt").write_text("40 40 23.5 17.5\n")
    assert_same(load_photographs(timed, points=False), photographs(names=names))


def test_poses_belong_to_images_by_number(tmp_path):
    poses = np.tile(np.eye(4), (11, 1, 1))
    poses[:, 0, 3] = range(11)
    write_log(tmp_path, poses)
    for i in range(11):
        cv2.imwrite(str(tmp_path / f"{i}.png"), BYTES[i % 4])
    source = open_photographs(tmp_path, intrinsics=LENS)
    assert {f.name: f.pose[0, 3] for f in source.frames} == {f"{i}.png": i for i in range(11)}


def test_distortion_is_taken_out(model):
    """A wall photographed through a bent lens, made by asking the lens itself."""
    bent = np.array([-0.12, 0.03, 0.001, -0.002])
    y, x = np.mgrid[:36, :48].astype(np.float32)
    straight = cv2.undistortPoints(np.stack([x, y], -1).reshape(-1, 1, 2), MATRIX, bent, P=MATRIX)
    u, v = straight.reshape(36, 48, 2).transpose(2, 0, 1)
    for image, name in zip(IMAGES.astype(np.float32), "abcd", strict=True):
        image = cv2.remap(image, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        stored = np.round(255 * image[..., ::-1].clip(0, 1)).astype(np.uint8)
        cv2.imwrite(str(model / "images" / f"{name}.png"), stored)
    rows = [f"{i} OPENCV 48 36 40 40 24 18 -0.12 0.03 0.001 -0.002" for i in range(1, 5)]
    (model / "sparse" / "0" / "cameras.txt").write_text("\n".join(rows) + "\n")
    found = load_photographs(model)
    matrix = np.asarray(found.intrinsics[0])
    assert matrix[0, 0] != 40.0
    # The same directions show the same colors.
    direction = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(matrix).T @ MATRIX.T
    place = direction.astype(np.float32)[..., :2].transpose(2, 0, 1)
    wanted = cv2.remap(IMAGES[0].astype(np.float32), place[0], place[1], cv2.INTER_CUBIC)
    assert np.abs(np.asarray(found.images[0]) - wanted)[4:-4, 4:-4].mean() < 0.01


def test_ngp_says_fisheye_and_angles_in_its_own_way(tmp_path):
    write_nerfstudio(tmp_path, photographs())
    file = tmp_path / "transforms.json"
    bent = {"is_fisheye": True, "k1": 0.05, "k2": 0.01}
    change_json(file, lambda t: {k: v for k, v in t.items() if k != "camera_model"} | bent)
    lens = open_photographs(tmp_path).frames[0].lens
    assert lens.fisheye
    assert lens.distortion == (0.05, 0.01, 0, 0)
    angles, unknown = {"camera_angle_x": 1.0, "camera_angle_y": 0.8}, {"fl_x": None, "fl_y": None}
    change_json(file, lambda t: angles | {"frames": [f | unknown for f in t["frames"]]})
    matrix = open_photographs(tmp_path).frames[0].lens.matrix
    focal = 0.5 * np.array(IMAGES.shape[2:0:-1]) / np.tan([0.5, 0.4])
    assert_allclose(matrix[[0, 1], [0, 1]], focal)


def test_neighbors_share_points(model):
    assert nearby(open_photographs(model), "b", 3) == ["a.png", "b.png", "c.png"]
    found = load_photographs(model, around="d.png", most=2)
    assert found.names == ("a.png", "d.png")
    assert given(found.points).shape == (4, 3)
    with pytest.raises(ValueError, match="has no photograph called 'e'; there are a.png"):
        load_photographs(model, around="e", most=2)


def test_points_that_nobody_is_known_to_see_are_kept(tmp_path):
    write_colmap(tmp_path, photographs(observed=None))
    source = open_photographs(tmp_path)
    assert source.observed is None
    # The nearest cameras, not the first names.
    order = np.argsort(np.linalg.norm(POSES[:, :3, 3] - POSES[3, :3, 3], axis=1))[:2]
    assert nearby(source, "d.png", 2) == ["abcd"[i] + ".png" for i in sorted(order)]
    assert given(load_photographs(tmp_path, around="d.png", most=2).points).shape == (4, 3)
    (tmp_path / "sparse" / "0" / "points3D.txt").write_text("# none\n")
    assert load_photographs(tmp_path, points=False).points is None


def test_features_are_triangulated_where_they_are():
    matrix = MATRIX * np.array([[4.0], [4.0], [1.0]])
    matrix[:2, 2] = [95.5, 71.5]
    images, _ = wall(POSES, matrix=matrix, size=(144, 192))
    matrices = np.broadcast_to(matrix, (4, 3, 3))
    points, observed = triangulated(images.astype(np.float32), POSES, matrices)
    assert len(points) > 20
    assert observed.sum(0).min() >= 2
    normal = np.array([0.15, -0.1, 1.0]) / np.linalg.norm([0.15, -0.1, 1.0])
    assert np.median(np.abs(points @ normal - 2.0)) < 0.02


@pytest.mark.parametrize("scale", [0.5, 0.25])
def test_shrunk_depth_is_that_of_the_middle_of_a_pixel(tmp_path, scale):
    y, x = np.mgrid[: DEPTHS.shape[1], : DEPTHS.shape[2]].astype(float)
    write_nerfstudio(tmp_path, photographs(), depth={0: 2 + 0.02 * x + 0.01 * y})
    depth = given(load_photographs(tmp_path, scale=scale).depth)[0]
    rows, columns = (np.mgrid[: depth.shape[0], : depth.shape[1]] + 0.5) / scale - 0.5
    assert np.abs(depth - (2 + 0.02 * columns + 0.01 * rows)).max() < 0.016


def test_point_clouds_come_back(tmp_path):
    path, rng = tmp_path / "cloud.ply", np.random.default_rng(0)
    points, normals = rng.normal(size=(2, 50, 3)).astype(np.float32)
    colors = rng.integers(0, 255, (50, 3)).astype(np.uint8)
    write_ply(path, points, colors=colors, normals=normals, error=points[:, 0])
    assert_array_equal(read_ply(path), points)
    whole = path.read_bytes()
    path.write_bytes(whole[:-5])
    with pytest.raises(ValueError, match="is truncated: 50 points of 31 bytes are announced"):
        read_ply(path)
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    head = f"ply\nformat ascii 1.0\nelement vertex 2\n{axes}end_header\n"
    path.write_text(head + "1 2 3\n4 5 6\n")
    assert_array_equal(read_ply(path), [[1, 2, 3], [4, 5, 6]])
    path.write_bytes(whole)
    cloud = pytest.importorskip("trimesh").load(path)
    assert_array_equal(cloud.vertices, points)
    assert_array_equal(cloud.colors[:, :3], colors)


def test_photographs_of_one_name_keep_their_own_files(tmp_path):
    names = ("left/0.png", "right/0.png", "right/0.jpg", "plain")
    write_nerfstudio(tmp_path, photographs(names=names), depth=dict(enumerate(DEPTHS)))
    found = load_photographs(tmp_path)
    order = [list(found.names).index(name) for name in map("images/{}".format, names[:3])]
    assert_allclose(given(found.depth)[order], DEPTHS[:3], rtol=1e-6)
    write_colmap(tmp_path / "model", photographs(names=names))
    names = load_photographs(tmp_path / "model").names
    assert names == ("left/0.png", "plain.png", "right/0.jpg", "right/0.png")


def test_names_and_poses_that_cannot_be_written_or_held_are_refused(tmp_path):
    for write in (write_colmap, write_nerfstudio):
        for first, match in (("../a", "which leads out of"), ("b", "have the name 'b' besides")):
            bad = photographs(names=(first, "b.png", "c.png", "d.png"))
            with pytest.raises(ValueError, match=match):
                write(tmp_path / "model", bad)
        assert not (tmp_path / "model").exists()
    poses = POSES.copy()
    poses[:, 0, 3] += 4.5e6
    with pytest.raises(ValueError, match="subtract the mean of the cameras' centers"):
        Photographs(IMAGES.astype(np.float32), poses, MATRIX)
    Photographs(IMAGES.astype(np.float64), poses, MATRIX)
    with pytest.raises(ValueError, match="must be float32 or float64"):
        Photographs(IMAGES.astype(np.float16), POSES, MATRIX)


@pytest.mark.slow
def test_living_room():
    lens = (525.0, 525.0, 319.5, 239.5)
    found = load_photographs(shared_data("mvs", "livingroom5"), intrinsics=lens)
    assert found.images.shape == (5, 480, 640, 3)
    assert given(found.points).shape[0] > 300
    for i, depth in enumerate(given(found.depth)):
        inside = found.point_depths(i)
        low, high = np.quantile(depth[depth > 0], (0, 1))
        assert np.mean((inside > 0.97 * low) & (inside < 1.03 * high)) > 0.97
    assert jnp.isfinite(found.images).all()
