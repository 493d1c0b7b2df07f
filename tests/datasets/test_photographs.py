"""Posed photographs from files: every form says the same, and what is wrong is said plainly."""

import json
import struct
from typing import Any

import cv2
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import shared_data
from posed.walls import MATRIX, POSES, wall
from scipy.spatial.transform import Rotation

from mvedge_jax.datasets.exchange import read_ply, write_colmap, write_nerfstudio, write_ply
from mvedge_jax.datasets.photographs import load_photographs
from mvedge_jax.datasets.photographs._photographs import nearby, open_photographs
from mvedge_jax.datasets.photographs._posed_source import rotation_of
from mvedge_jax.posed import Photographs

IMAGES, DEPTHS = wall(POSES)
BYTES = np.round(255 * IMAGES) / 255
# Corners and middle of the wall, of which the last photograph does not see the first one.
CORNERS = np.array([[-0.5, -0.3, 2.0], [0.5, -0.3, 1.9], [0.1, 0.2, 2.0], [-0.2, 0.25, 2.1]])
OBSERVED = np.ones((4, 4), bool)
OBSERVED[3, 0] = False


def given(value: Any) -> np.ndarray:
    """What may be None, and is not."""
    assert value is not None
    return np.asarray(value)


def photographs(**changes):
    known = {
        "points": CORNERS,
        "observed": OBSERVED,
        "names": ("a.png", "b.png", "c.png", "d.png"),
        **changes,
    }
    return Photographs(BYTES, POSES, MATRIX, **known)


@pytest.fixture
def model(tmp_path):
    write_colmap(tmp_path / "model", photographs())
    return tmp_path / "model"


def same(found, wanted):
    np.testing.assert_allclose(found.images, wanted.images, atol=1e-6)
    np.testing.assert_allclose(found.poses, wanted.poses, atol=1e-6)
    np.testing.assert_allclose(found.intrinsics, wanted.intrinsics, atol=1e-5)
    assert found.names == wanted.names


def binary(folder):
    """The model of `folder` in binary form, written by the letter of COLMAP's description."""
    sparse = folder / "sparse" / "0"
    cameras = [line.split() for line in (sparse / "cameras.txt").read_text().splitlines()[1:]]
    data = struct.pack("<Q", len(cameras))
    for number, _, width, height, *values in cameras:
        data += struct.pack("<iiQQ4d", int(number), 1, int(width), int(height), *map(float, values))
    (sparse / "cameras.bin").write_bytes(data)
    lines = (sparse / "images.txt").read_text().splitlines()[1:]
    data = struct.pack("<Q", len(lines) // 2)
    for head, features in zip(lines[::2], lines[1::2], strict=True):
        number, *pose, camera, name = head.split()
        data += struct.pack("<i7di", int(number), *map(float, pose), int(camera))
        data += name.encode() + b"\0"
        words = features.split()
        data += struct.pack("<Q", len(words) // 3)
        for x, y, point in zip(words[::3], words[1::3], words[2::3], strict=True):
            data += struct.pack("<ddq", float(x), float(y), int(point))
    (sparse / "images.bin").write_bytes(data)
    rows = [line.split() for line in (sparse / "points3D.txt").read_text().splitlines()[1:]]
    data = struct.pack("<Q", len(rows))
    for number, x, y, z, r, g, b, error, *track in rows:
        data += struct.pack("<Q3d3Bd", int(number), *map(float, (x, y, z)), *map(int, (r, g, b)),
                            float(error))  # fmt: skip
        data += struct.pack("<Q", len(track) // 2) + struct.pack(
            f"<{len(track)}i", *map(int, track)
        )
    (sparse / "points3D.bin").write_bytes(data)
    for name in ("cameras", "images", "points3D"):
        (sparse / f"{name}.txt").unlink()
    return folder


def test_colmap_text_and_binary_say_the_same(model):
    text = load_photographs(model)
    same(text, photographs())
    np.testing.assert_allclose(given(text.points), CORNERS, atol=1e-6)
    np.testing.assert_array_equal(text.observed, OBSERVED)
    again = load_photographs(binary(model))
    same(again, text)
    np.testing.assert_array_equal(again.points, text.points)
    np.testing.assert_array_equal(again.observed, text.observed)


def test_pycolmap_reads_what_we_write_and_we_what_it_writes(model, tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    stored = pycolmap.Reconstruction(str(model / "sparse" / "0"))
    assert len(stored.images) == 4
    assert len(stored.points3D) == 4
    for image in stored.images.values():
        i = "abcd".index(image.name[0])
        centre = image.projection_center()
        np.testing.assert_allclose(centre, POSES[i, :3, 3], atol=1e-6)
        camera = stored.cameras[image.camera_id]
        for k, point in stored.points3D.items():
            # COLMAP's pixel centres are at .5, ours at integers.
            place = camera.img_from_cam(image.cam_from_world() * point.xyz)
            local = POSES[i, :3, :3].T @ (CORNERS[k - 1] - POSES[i, :3, 3])
            wanted = (MATRIX @ local)[:2] / local[2]
            np.testing.assert_allclose(place - 0.5, wanted, atol=1e-5)
    for form in ("text", "binary"):
        folder = tmp_path / form
        (folder / "sparse").mkdir(parents=True)
        getattr(stored, f"write_{form}")(str(folder / "sparse"))
        again = load_photographs(folder, images=model / "images")
        same(again, photographs())
        np.testing.assert_array_equal(
            np.sort(given(again.observed).sum(0)), np.sort(OBSERVED.sum(0))
        )


def test_nerfstudio_comes_back(tmp_path):
    depth = {1: DEPTHS[1]}
    write_nerfstudio(tmp_path, photographs(), depth=depth)
    found = load_photographs(tmp_path)
    same(found, photographs())
    np.testing.assert_allclose(given(found.points), CORNERS, atol=1e-6)
    np.testing.assert_allclose(given(found.depth)[1], DEPTHS[1], rtol=1e-6)
    assert float(given(found.depth)[0].max()) == 0
    mask = given(cv2.imread(str(tmp_path / "masks" / "b.png.png"), cv2.IMREAD_UNCHANGED))
    assert mask.min() == 255
    # OpenGL's camera looks along its negative z axis.
    frame = json.loads((tmp_path / "transforms.json").read_text())["frames"][2]
    np.testing.assert_allclose(-np.array(frame["transform_matrix"])[:3, 2], POSES[2, :3, 2])


def test_lists_of_poses(tmp_path):
    for name, image in zip(("00.png", "01.png", "02.png", "03.png"), BYTES, strict=True):
        cv2.imwrite(str(tmp_path / name), np.round(255 * image[..., ::-1]).astype(np.uint8))
    lines = [f"{i} {i} {i + 1}\n" + "\n".join(" ".join(map(repr, map(float, row))) for row in pose)
             for i, pose in enumerate(POSES)]  # fmt: skip
    (tmp_path / "trajectory.log").write_text("\n".join(lines) + "\n")
    given = (40.0, 40.0, 23.5, 17.5)
    same(load_photographs(tmp_path, intrinsics=given, points=False),
         photographs(names=("00.png", "01.png", "02.png", "03.png")))  # fmt: skip
    with pytest.raises(ValueError, match="does not say its camera's intrinsics; give"):
        load_photographs(tmp_path)
    timed = tmp_path / "timed"
    timed.mkdir()
    rows = []
    for i, pose in enumerate(POSES):
        (tmp_path / f"0{i}.png").rename(timed / f"{i}.500.png")
        w, x, y, z = quaternion_of(pose[:3, :3])
        rows.append(" ".join(map(repr, map(float, (i + 0.51, *pose[:3, 3], x, y, z, w)))))
    (timed / "groundtruth.txt").write_text("# time and pose\n" + "\n".join(rows) + "\n")
    (timed / "camera.txt").write_text("40 40 23.5 17.5\n")
    same(load_photographs(timed, points=False),
         photographs(names=tuple(f"{i}.500.png" for i in range(4))))  # fmt: skip


def quaternion_of(turn):
    return np.roll(Rotation.from_matrix(turn).as_quat(canonical=True), 1)


def test_rotations_and_quaternions_are_inverse():
    rng = np.random.default_rng(0)
    for quaternion in rng.normal(size=(50, 4)):
        unit = quaternion / np.linalg.norm(quaternion)
        found = quaternion_of(rotation_of(unit, where="test"))
        np.testing.assert_allclose(found * np.sign(found @ unit), unit, atol=1e-12)


def test_distortion_is_taken_out(model):
    """A wall photographed through a bent lens, made by asking the lens itself."""
    bent = np.array([-0.12, 0.03, 0.001, -0.002])
    y, x = np.mgrid[:36, :48].astype(np.float32)
    straight = cv2.undistortPoints(np.stack([x, y], -1).reshape(-1, 1, 2), MATRIX, bent, P=MATRIX)
    u, v = straight.reshape(36, 48, 2).transpose(2, 0, 1)
    for i, name in enumerate("abcd"):
        image = cv2.remap(IMAGES[i].astype(np.float32), u, v, cv2.INTER_CUBIC,
                          borderMode=cv2.BORDER_REPLICATE)  # fmt: skip
        stored = np.round(255 * image[..., ::-1].clip(0, 1)).astype(np.uint8)
        cv2.imwrite(str(model / "images" / f"{name}.png"), stored)
    cameras = model / "sparse" / "0" / "cameras.txt"
    rows = [f"{i} OPENCV 48 36 40 40 24 18 -0.12 0.03 0.001 -0.002" for i in range(1, 5)]
    cameras.write_text("\n".join(rows) + "\n")
    found = load_photographs(model)
    matrix = np.asarray(found.intrinsics[0])
    assert matrix[0, 0] != 40.0
    # The same directions show the same colours.
    direction = (np.stack([x, y, np.ones_like(x)], -1)) @ np.linalg.inv(matrix).T @ MATRIX.T
    wanted = cv2.remap(IMAGES[0].astype(np.float32), direction[..., 0].astype(np.float32),
                       direction[..., 1].astype(np.float32), cv2.INTER_CUBIC)  # fmt: skip
    inner = np.s_[4:-4, 4:-4]
    assert np.abs(np.asarray(found.images[0]) - wanted)[inner].mean() < 0.01


def spoil(folder, name, change):
    file = folder / "sparse" / "0" / name
    file.write_text(change(file.read_text()))


MALFORMED = [
    (
        "missing image",
        lambda f: (f / "images" / "b.png").unlink(),
        FileNotFoundError,
        r"b\.png is missing",
    ),
    (
        "unknown camera model",
        lambda f: spoil(f, "cameras.txt", lambda t: t.replace("1 PINHOLE", "1 BANANA")),
        ValueError,
        "has the camera model BANANA, which is not handled; expected one of SIMPLE_PINHOLE",
    ),
    (
        "wrong intrinsics",
        lambda f: spoil(
            f, "cameras.txt", lambda t: t.replace("PINHOLE 48 36 40", "PINHOLE 48 36 -4")
        ),
        ValueError,
        "has the intrinsics fx -4, .*expected finite numbers with positive focal lengths",
    ),
    (
        "intrinsics of another size",
        lambda f: spoil(f, "cameras.txt", lambda t: t.replace("48 36", "96 72")),
        ValueError,
        r"a\.png has 48x36 px, its camera 96x72",
    ),
    (
        "too few parameters",
        lambda f: spoil(f, "cameras.txt", lambda t: t.replace("24 18", "24")),
        ValueError,
        "has 3 fields; expected 4 parameters of PINHOLE",
    ),
    (
        "no numbers",
        lambda f: spoil(f, "images.txt", lambda t: t.replace("\n1 ", "\n1 x")),
        ValueError,
        "are no numbers; expected numbers of image, pose and camera",
    ),
    (
        "missing camera",
        lambda f: spoil(f, "cameras.txt", lambda t: "\n".join(t.splitlines()[:-1])),
        ValueError,
        r"image d\.png, is of camera 4, which cameras.txt does not hold",
    ),
    (
        "no cameras",
        lambda f: (f / "sparse" / "0" / "cameras.txt").unlink(),
        FileNotFoundError,
        r"cameras\.txt is missing; a COLMAP model has",
    ),
    (
        "no folder of images",
        lambda f: (f / "images").rename(f / "pictures"),
        FileNotFoundError,
        "has no folder of images beside it",
    ),
]


@pytest.mark.parametrize(
    ("change", "kind", "message"), [m[1:] for m in MALFORMED], ids=[m[0] for m in MALFORMED]
)
def test_malformed_models(model, change, kind, message):
    change(model)
    with pytest.raises(kind, match=message):
        load_photographs(model)


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_truncated_binaries(model, name):
    file = binary(model) / "sparse" / "0" / f"{name}.bin"
    whole = file.read_bytes()
    for length in (0, 5, 8, 30, len(whole) // 2, len(whole) - 1):
        file.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=rf"{name}\.bin is truncated or damaged"):
            load_photographs(model)
    # A count that no file could hold is no reason to ask for memory.
    file.write_bytes(struct.pack("<Q", 2**60) + whole[8:])
    with pytest.raises(ValueError, match="is truncated or damaged"):
        load_photographs(model)


def test_empty_points_and_unknown_folders(model, tmp_path):
    (model / "sparse" / "0" / "points3D.txt").write_text("# none\n")
    assert load_photographs(model, points=False).points is None
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="holds no posed photographs; expected a COLMAP model"):
        load_photographs(tmp_path / "empty")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t | {"frames": []}, "lists 0 frames"),
        (lambda t: {"x": 1}, "has no list `frames`"),
        (lambda t: t | {"camera_model": "EQUIRECTANGULAR"}, "has the camera model 'EQUIRECT"),
        (
            lambda t: t | {"frames": [{**f, "transform_matrix": [[1, 2]]} for f in t["frames"]]},
            "has no `transform_matrix` of 4x4 numbers",
        ),
        (
            lambda t: t | {"frames": [{**f, "fl_x": None} for f in t["frames"]]},
            "has no intrinsics; expected fl_x",
        ),
        (lambda t: t | {"depth_unit_scale_factor": None}, "depth_unit_scale_factor = None"),
        (lambda t: t | {"depth_unit_scale_factor": -1}, "depth_unit_scale_factor = -1"),
        (
            lambda t: {
                "camera_angle_x": 0,
                "frames": [{**f, "fl_x": None, "fl_y": None} for f in t["frames"]],
            },
            "camera_angle_x = 0; expected radians",
        ),
        (
            lambda t: t | {"frames": [{**f, "transform_matrix": np.zeros((4, 4)).tolist()}
                                      for f in t["frames"]]},
            "has no rotation",
        ),
    ],
)  # fmt: skip
def test_malformed_transforms(tmp_path, change, message):
    write_nerfstudio(tmp_path, photographs())
    file = tmp_path / "transforms.json"
    file.write_text(json.dumps(change(json.loads(file.read_text()))))
    with pytest.raises(ValueError, match=message):
        load_photographs(tmp_path)


def test_point_clouds_come_back(tmp_path):
    path = tmp_path / "cloud.ply"
    rng = np.random.default_rng(0)
    points, normals = rng.normal(size=(2, 50, 3)).astype(np.float32)
    colours = rng.integers(0, 255, (50, 3)).astype(np.uint8)
    write_ply(path, points, colours=colours, normals=normals, error=points[:, 0])
    np.testing.assert_array_equal(read_ply(path), points)
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(ValueError, match="is truncated: 50 points of 31 bytes are announced"):
        read_ply(path)
    path.write_text("ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
                    "property float z\nend_header\n1 2 3\n4 5 6\n")  # fmt: skip
    np.testing.assert_array_equal(read_ply(path), [[1, 2, 3], [4, 5, 6]])


def test_trimesh_reads_our_point_clouds(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    rng = np.random.default_rng(0)
    points, normals = rng.normal(size=(2, 50, 3)).astype(np.float32)
    colours = rng.integers(0, 255, (50, 3)).astype(np.uint8)
    write_ply(tmp_path / "cloud.ply", points, colours=colours, normals=normals)
    cloud = trimesh.load(tmp_path / "cloud.ply")
    np.testing.assert_array_equal(cloud.vertices, points)
    np.testing.assert_array_equal(cloud.colors[:, :3], colours)


def test_names_do_not_lead_out_of_the_folder(tmp_path):
    bad = photographs(names=("../a.png", "b.png", "c.png", "d.png"))
    for write in (write_colmap, write_nerfstudio):
        with pytest.raises(ValueError, match="which leads out of"):
            write(tmp_path / "model", bad)
    assert not (tmp_path / "model").exists()


def test_far_pixels_leave_the_others_their_depth_and_nerfstudio_its_unit(tmp_path):
    depth = DEPTHS[1].copy()
    depth[0, :3] = 2e6, np.inf, 0
    write_nerfstudio(tmp_path, photographs(), depth={1: depth})
    found = given(load_photographs(tmp_path).depth)[1]
    np.testing.assert_allclose(found[1:], DEPTHS[1][1:], rtol=1e-6)
    np.testing.assert_allclose(found[0, :3], [2e6, 0, 0])
    # What nerfstudio makes of it with its defaults, whatever the file says.
    frame = json.loads((tmp_path / "transforms.json").read_text())["frames"][1]
    np.testing.assert_allclose(1e-3 * np.load(tmp_path / frame["depth_file_path"]), found)
    mask = given(cv2.imread(str(tmp_path / frame["mask_path"]), cv2.IMREAD_UNCHANGED))
    np.testing.assert_array_equal(mask > 0, found > 0)
    np.save(tmp_path / frame["depth_file_path"], np.full(depth.shape, np.nan))
    with pytest.raises(ValueError, match="must hold finite numbers"):
        load_photographs(tmp_path)


def test_photographs_of_one_name_keep_their_own_files(tmp_path):
    names = ("left/0.png", "right/0.png", "right/0.jpg", "plain")
    write_nerfstudio(tmp_path, photographs(names=names), depth=dict(enumerate(DEPTHS)))
    found = load_photographs(tmp_path)
    order = [list(found.names).index(name) for name in map("images/{}".format, names[:3])]
    np.testing.assert_allclose(given(found.depth)[order], DEPTHS[:3], rtol=1e-6)
    write_colmap(tmp_path / "model", photographs(names=names))
    assert load_photographs(tmp_path / "model").names == (
        "left/0.png", "plain.png", "right/0.jpg", "right/0.png",
    )  # fmt: skip
    with pytest.raises(ValueError, match="have the name 'a' besides 'a.png'"):
        write_colmap(tmp_path / "none", photographs(names=("a", "a.png", "b.png", "c.png")))
    assert not (tmp_path / "none").exists()


def test_neighbours_share_points(model):
    source = open_photographs(model)
    assert nearby(source, "b", 3) == ["a.png", "b.png", "c.png"]
    found = load_photographs(model, around="d.png", most=2)
    assert found.names == ("a.png", "d.png")
    assert given(found.points).shape == (4, 3)
    with pytest.raises(ValueError, match="has no photograph called 'e'; there are a.png"):
        load_photographs(model, around="e", most=2)


def test_features_are_triangulated_where_they_are():
    from mvedge_jax.datasets.photographs._sift import triangulated

    matrix = MATRIX * np.array([[4.0], [4.0], [1.0]])
    matrix[:2, 2] = [95.5, 71.5]
    images, _ = wall(POSES, matrix=matrix, size=(144, 192))
    points, observed = triangulated(
        images.astype(np.float32), POSES, np.broadcast_to(matrix, (4, 3, 3))
    )
    assert len(points) > 20
    assert observed.sum(0).min() >= 2
    normal = np.array([0.15, -0.1, 1.0]) / np.linalg.norm([0.15, -0.1, 1.0])
    off = np.abs(points @ normal - 2.0)
    assert np.median(off) < 0.02


@pytest.mark.slow
def test_living_room():
    found = load_photographs(
        shared_data("mvs", "livingroom5"), intrinsics=(525.0, 525.0, 319.5, 239.5)
    )
    assert found.images.shape == (5, 480, 640, 3)
    assert given(found.points).shape[0] > 300
    for i in range(5):
        inside = found.point_depths(i)
        low, high = np.quantile(given(found.depth)[i][given(found.depth)[i] > 0], (0, 1))
        assert np.mean((inside > 0.97 * low) & (inside < 1.03 * high)) > 0.97
    assert jnp.isfinite(found.images).all()


def test_ngp_says_fisheye_and_angles_in_its_own_way(tmp_path):
    write_nerfstudio(tmp_path, photographs())
    file = tmp_path / "transforms.json"
    known = json.loads(file.read_text())
    del known["camera_model"]
    bent = {"is_fisheye": True, "k1": 0.05, "k2": 0.01}
    file.write_text(json.dumps(known | bent))
    lens = open_photographs(tmp_path).frames[0].lens
    assert lens.fisheye
    assert lens.distortion == (0.05, 0.01, 0, 0)
    angles = {"camera_angle_x": 1.0, "camera_angle_y": 0.8}
    for frame in known["frames"]:
        frame |= {"fl_x": None, "fl_y": None}
    file.write_text(json.dumps(known | angles))
    matrix = open_photographs(tmp_path).frames[0].lens.matrix
    height, width = IMAGES.shape[1:3]
    np.testing.assert_allclose(
        matrix[[0, 1], [0, 1]], [0.5 * width / np.tan(0.5), 0.5 * height / np.tan(0.4)]
    )


def test_poses_belong_to_images_by_number(tmp_path):
    many = 11
    for i in range(many):
        image = np.round(255 * BYTES[i % 4][..., ::-1]).astype(np.uint8)
        cv2.imwrite(str(tmp_path / f"{i}.png"), image)
    rows = "\n".join(f"{i} {i} {i + 1}\n1 0 0 {i}\n0 1 0 0\n0 0 1 0\n0 0 0 1" for i in range(many))
    (tmp_path / "trajectory.log").write_text(rows + "\n")
    source = open_photographs(tmp_path, intrinsics=(40.0, 40.0, 23.5, 17.5))
    assert {f.name: f.pose[0, 3] for f in source.frames} == {f"{i}.png": i for i in range(many)}


def test_points_that_nobody_is_known_to_see_are_kept(tmp_path):
    write_colmap(tmp_path, photographs(observed=None))
    source = open_photographs(tmp_path)
    assert source.observed is None
    # The nearest cameras, not the first names.
    centres = POSES[:, :3, 3]
    order = np.argsort(np.linalg.norm(centres - centres[3], axis=1))[:2]
    assert nearby(source, "d.png", 2) == ["abcd"[i] + ".png" for i in sorted(order)]
    assert given(load_photographs(tmp_path, around="d.png", most=2).points).shape == (4, 3)


@pytest.mark.parametrize("insert", [None, 2])
def test_lines_of_images_that_do_not_alternate_are_refused(model, insert):
    file = model / "sparse" / "0" / "images.txt"
    lines = file.read_text().splitlines()
    lines = [line for line in lines if len(line.split()) > 9] if insert is None else lines
    # The places of points are gone, or a line is in between.
    heads = [line for line in lines if line.endswith(".png")]
    lines = heads if insert is None else [*lines[:1], *heads[:1], "", "", *heads[1:]]
    file.write_text("\n".join(lines) + "\n")
    with pytest.raises(ValueError, match=r"images.txt, line \d"):
        load_photographs(model)


@pytest.mark.parametrize(
    "numbers", ["330 330 510.5 365.5 -.02 .002 0 0", "300 300 500 375 0 0 0 0"]
)
def test_fisheyes_that_no_plane_can_show_are_refused(tmp_path, numbers):
    write_colmap(tmp_path, photographs())
    large = np.zeros((750, 1000, 3), np.uint8)
    for file in (tmp_path / "images").iterdir():
        cv2.imwrite(str(file), large)
    cameras = [f"{i} OPENCV_FISHEYE 1000 750 {numbers}" for i in range(1, 5)]
    (tmp_path / "sparse" / "0" / "cameras.txt").write_text("\n".join(cameras) + "\n")
    with pytest.raises(ValueError, match=r"cannot be straightened|far outside of its"):
        load_photographs(tmp_path)


@pytest.mark.parametrize("scale", [0.5, 0.25])
def test_shrunk_depth_is_that_of_the_middle_of_a_pixel(tmp_path, scale):
    y, x = np.mgrid[: DEPTHS.shape[1], : DEPTHS.shape[2]].astype(float)
    slanted = 2 + 0.02 * x + 0.01 * y
    write_nerfstudio(tmp_path, photographs(), depth={0: slanted})
    depth = given(load_photographs(tmp_path, scale=scale).depth)[0]
    rows, columns = np.mgrid[: depth.shape[0], : depth.shape[1]]
    middle = 2 + 0.02 * ((columns + 0.5) / scale - 0.5) + 0.01 * ((rows + 0.5) / scale - 0.5)
    assert np.abs(depth - middle).max() < 0.016


def test_features_lie_where_they_are():
    from mvedge_jax.datasets.photographs._sift import _features

    y, x = np.mgrid[:120, :140].astype(float)
    wanted = np.asarray([[60.0, 60.0], [100.5, 30.25], [30.3, 90.7]])
    image = sum(np.exp(-((x - a) ** 2 + (y - b) ** 2) / 32) for a, b in wanted)
    found, _ = _features(np.repeat(np.clip(image, 0, 1)[..., None], 3, axis=2).astype(np.float32))
    for place in wanted:
        assert np.linalg.norm(found - place, axis=1).min() < 0.05


def test_poses_that_single_precision_cannot_tell_apart_are_refused():
    poses = POSES.copy()
    poses[:, 0, 3] += 4.5e6
    with pytest.raises(ValueError, match="subtract the mean of the cameras' centres"):
        Photographs(BYTES.astype(np.float32), poses, MATRIX)
    Photographs(BYTES.astype(np.float64), poses, MATRIX)
    with pytest.raises(ValueError, match="must be float32 or float64"):
        Photographs(BYTES.astype(np.float16), POSES, MATRIX)
