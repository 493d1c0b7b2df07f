"""`mvedge stereo` and `mvedge export`: files are complete, and say the same elsewhere."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cli.scenes import write_result, write_stereo_result, write_wall
from datasets.layouts import write_hci
from posed.walls import MATRIX, POSES, places, wall

from mvedge_jax.cli._paths import stems_of
from mvedge_jax.datasets import read_pfm, synthetic, write_hci as write_scene
from mvedge_jax.datasets.exchange import read_ply, write_colmap
from mvedge_jax.datasets.photographs import load_photographs
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import Noise
from mvedge_jax.posed import Photographs, StereoResult, StereoStats
from mvedge_jax.posed.cloud import photographs_of
from mvedge_jax.posed.sparse import SparseStereoDepth

IMAGES, DEPTHS = wall(POSES)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return write_wall(tmp_path_factory.mktemp("model") / "model")[0]


@pytest.mark.slow
def test_stereo_and_its_export(model, tmp_path, mvedge):
    out = tmp_path / "depth"
    mvedge("stereo", model, out, "--range", 1.2, 3.5, "--reference", 1)
    depth, error = read_pfm(out / "1_depth.pfm"), read_pfm(out / "1_error.pfm")
    assert np.median(np.abs(depth / DEPTHS[1] - 1)) < 0.01
    assert np.isfinite(error).all()
    for name in ("1_depth.png", "1_error.png"):
        assert (out / name).stat().st_size > 0
    report = json.loads((out / "report.json").read_text())
    assert report["photographs"]["1"]["measured in"] == [f"{i}.png" for i in range(4)]
    mvedge("export", out, tmp_path / "cloud", "--to", "ply")
    points = read_ply(tmp_path / "cloud" / "1.ply")
    local = (points - POSES[1][:3, 3]) @ POSES[1][:3, :3]
    np.testing.assert_allclose(local[:, 2], depth.ravel(), rtol=1e-5)
    mvedge("export", out, tmp_path / "nerf", "--to", "nerfstudio")
    again = load_photographs(tmp_path / "nerf")
    assert again.depth is not None
    np.testing.assert_allclose(again.depth[1], depth, atol=1e-4)


def test_a_depth_that_failed_is_said_on_the_screen_and_in_the_report(
    model, tmp_path, mvedge, monkeypatch
):
    depth = jnp.full(DEPTHS[1].shape, 2.0)
    stats = StereoStats(
        iterations=jnp.asarray([9]),
        converged=jnp.asarray(True),
        noise=Noise.of(jnp.zeros(())),
        gain=jnp.ones(4),
        searched=jnp.asarray([0.0, 9.0]),
        labeled=jnp.asarray(0.25),
    )
    failed = StereoResult(depth, 0.2 * depth, depth, 0.2 * depth, depth, stats)
    monkeypatch.setattr("mvedge_jax.cli._stereo.estimate", lambda *_: failed)
    out = tmp_path / "out"
    said = mvedge("stereo", model, out, "--range", 1.2, 3.5, "--reference", 1)
    row = json.loads((out / "report.json").read_text())["photographs"]["1"]
    assert row["pixels without an accepted label, %"] == 75
    assert row["warnings"] == list(failed.problems())
    assert "75 % of the pixels have no accepted label" in row["warnings"][0]
    assert "above 20 % of their depth" in row["warnings"][1]
    assert all(f"1: {text}" in said.err for text in row["warnings"])


@pytest.mark.slow
def test_points_are_optimized_and_exported_without_errors(tmp_path, mvedge, monkeypatch):
    few = SparseStereoDepth(smoothing=2, iterations=2, passes=1)
    monkeypatch.setattr("mvedge_jax.cli._stereo.SparseStereoDepth", lambda: few)
    pixels = np.random.default_rng(0).permutation(DEPTHS[1].size)[:40]
    points = places(POSES[1], DEPTHS[1]).reshape(-1, 3)[pixels]
    names = tuple(f"{i}.png" for i in range(4))
    seen = np.ones((4, len(points)), bool)
    known = Photographs(
        IMAGES.astype(np.float32), POSES, MATRIX, names=names, points=points, observed=seen
    )
    write_colmap(tmp_path / "model", known)
    out = tmp_path / "depth"
    mvedge("stereo", tmp_path / "model", out, "--method", "points", "--reference", 1)
    depth = read_pfm(out / "1_depth.pfm")
    assert np.median(np.abs(depth / DEPTHS[1] - 1)) < 0.05
    assert sorted(p.name for p in out.iterdir() if "error" in p.name) == []
    report = json.loads((out / "report.json").read_text())
    assert report["method"] == "points"
    before, after = report["photographs"]["1"]["loss, before and after"]
    assert after <= before
    mvedge("export", out, tmp_path / "cloud", "--to", "ply")
    assert read_ply(tmp_path / "cloud" / "1.ply").shape == (depth.size, 3)


def test_a_reference_that_is_not_there_is_told(model, tmp_path, mvedge):
    said = mvedge("stereo", model, tmp_path / "out", "--reference", "nosuch", code=2)
    assert "has no photograph called 'nosuch'; there are 0.png" in said.err
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def light_field():
    return synthetic.render(
        synthetic.scene("slanted"), shape=(3, 3, 32, 40), samples=1, key=jax.random.key(0)
    )


@pytest.fixture
def scene(light_field, tmp_path):
    write_scene(light_field, tmp_path / "scene")
    return tmp_path / "scene"


@pytest.fixture
def result(scene, light_field, tmp_path):
    """What `mvedge depth` writes, the truth in the place of what it finds."""
    rows, columns = np.mgrid[4:28:6, 4:36:8]
    xy = np.stack([columns.ravel(), rows.ravel()], 1).astype(np.float32)
    return write_result(tmp_path / "result", scene, light_field.truth.disparity, xy=xy)


def test_a_light_field_in_colmap(result, tmp_path, mvedge):
    """Cameras, sensor shift and points: read by pycolmap, seen where the disparity says."""
    pycolmap = pytest.importorskip("pycolmap")
    out = tmp_path / "colmap"
    said = mvedge("export", result, out, "--to", "colmap").out
    assert "9 views with their cameras, 16 points" in said
    model = pycolmap.Reconstruction(str(out / "sparse" / "0"))
    assert len(model.images) == 9
    with np.load(result / "points.npz") as stored:
        xy, disparity = stored["xy"], stored["disparity"]
    assert len(model.points3D) == len(xy)
    for image in model.images.values():
        v, u = divmod(int(image.name[9:12]), 3)
        camera = model.cameras[image.camera_id]
        for k, point in model.points3D.items():
            place = camera.img_from_cam(image.cam_from_world() * point.xyz) - 0.5
            step = np.array([1 - u, 1 - v])
            np.testing.assert_allclose(place, xy[k - 1] + step * disparity[k - 1], atol=2e-3)


def test_a_light_field_in_nerfstudio(result, light_field, tmp_path, mvedge):
    out = tmp_path / "nerf"
    said = mvedge("export", result, out, "--to", "nerfstudio").out
    assert "9 views with their cameras, 16 points, depth of 1" in said
    found, wanted = load_photographs(out), photographs_of(light_field)
    for name, error in (("poses", 1e-6), ("intrinsics", 1e-4), ("images", 0.51 / 255)):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), atol=error)
    assert found.depth is not None
    assert wanted.depth is not None
    np.testing.assert_allclose(found.depth[4], wanted.depth[4], rtol=1e-3)
    assert (out / "masks" / "input_Cam004.png.png").exists()


def test_points_land_where_the_disparity_map_says(result, light_field, tmp_path, mvedge):
    """Within .05 px of it in every view."""
    for kind, name in (("dense", "input_Cam004.ply"), ("edges", "edges.ply")):
        out = tmp_path / kind
        said = mvedge("export", result, out, "--to", "ply", "--points", kind).out
        points = read_ply(out / name)
        assert f"1 point cloud ({name}), {len(points)} points" in said
        if kind == "dense":
            rows, columns = np.mgrid[:32, :40]
            disparity = np.asarray(light_field.truth.disparity)
        else:
            with np.load(result / "points.npz") as stored:
                columns, rows = stored["xy"].T
                disparity = stored["disparity"]
        views = photographs_of(light_field)
        for k in range(9):
            v, u = divmod(k, 3)
            local = (points - np.asarray(views.poses[k, :3, 3])) @ np.asarray(views.intrinsics[k]).T
            wanted = np.stack([columns + (1 - u) * disparity, rows + (1 - v) * disparity], -1)
            off = np.abs(local[:, :2] / local[:, 2:] - wanted.reshape(-1, 2)).max()
            assert off < 0.05


def test_a_camera_may_be_given_for_any_light_field(result, tmp_path, mvedge):
    (result / "report.json").write_text("{}")
    said = mvedge("export", result, tmp_path / "b", "--to", "ply", code=2)
    assert "does not tell its light field; make the result again" in said.err
    views = np.zeros((3, 3, 16, 16, 3), np.uint8)
    plain = write_hci(tmp_path / "plain", views, settings=False)
    with pytest.raises(ValueError, match="does not know its camera"):
        photographs_of(LightField(views.astype(np.float32)))
    mvedge("export", plain, tmp_path / "c", "--to", "colmap", "--camera", 100, 0.1, 2)
    assert isinstance(load_photographs(tmp_path / "c", points=False), Photographs)


@pytest.mark.parametrize(
    ("names", "wanted"),
    [
        (["a.png", "b/c.jpg"], ["a", "b_c"]),
        (["1.jpg", "1.png", "2.png"], ["1.jpg", "1.png", "2"]),
        (["/left/0.png", "../0.png"], ["left_0", "0"]),
        (["a/b.png", "a_b.png"], ["a_b.png_1", "a_b.png_2"]),
        (["a/b.png", "a_b.png", "a_b.png_1"], ["a_b.png_2", "a_b.png_3", "a_b.png_1"]),
    ],
)
def test_files_of_photographs_never_share_a_name(names, wanted):
    assert list(map(stems_of(names).get, names)) == wanted


def test_points_of_a_colmap_model_are_no_edge_points(model, tmp_path, mvedge):
    """They belong to no single photograph whose colors and normals could be looked up."""
    folder = write_stereo_result(
        tmp_path / "result", model, DEPTHS.astype(np.float32), tuple("0123")
    )
    words = ("export", folder, tmp_path / "out", "--to", "ply")
    said = mvedge(*words, "--points", "edges", code=2)
    assert "has no edge points; run mvedge depth" in said.err
    assert f"4 point clouds (0.ply, 1.ply, 2.ply, ...), {DEPTHS.size} points" in mvedge(*words).out
