"""HDF5 and MATLAB files."""

from functools import partial

import h5py
import numpy as np
import pytest
from datasets.layouts import cut, known, random_views, write_h5, write_mat

from mvedge_jax.datasets import load_light_field


def _shifting_views(direction_v, direction_u, disparity, size=24):
    """A textured plane whose views obey the convention, or not, on either axis."""
    texture = np.random.default_rng(0).integers(0, 256, (size * 2, size * 2, 3)).astype(np.uint8)
    views = np.zeros((5, 5, size, size, 3), np.uint8)
    for v, u in np.ndindex(5, 5):
        y = size // 2 - direction_v * (2 - v) * disparity
        x = size // 2 - direction_u * (2 - u) * disparity
        views[v, u] = texture[y : y + size, x : x + size]
    return views


@pytest.mark.parametrize("direction_v", [1, -1])
@pytest.mark.parametrize("direction_u", [1, -1])
def test_old_hci_is_put_in_the_order_of_its_ground_truth(tmp_path, direction_v, direction_u):
    disparity = 2
    views = _shifting_views(direction_v, direction_u, disparity)
    depth = np.full(views.shape[:4], 0.1 * 600 / (disparity + 10), np.float32)
    labels = np.broadcast_to(np.arange(24, dtype=np.uint8), views.shape[:4])
    loaded = load_light_field(write_h5(tmp_path / "buddha.h5", views, depth=depth, labels=labels))
    assert loaded.name == "buddha"
    expected = views[::direction_v, ::direction_u].astype(np.float32) / 255
    np.testing.assert_array_equal(np.asarray(loaded.views), expected)
    np.testing.assert_allclose(np.asarray(known(loaded.truth).disparity), disparity, rtol=1e-5)
    np.testing.assert_allclose(np.asarray(known(loaded.truth).view_disparity), disparity, rtol=1e-5)
    np.testing.assert_array_equal(np.asarray(known(loaded.truth).object_ids), labels[0, 0])
    np.testing.assert_array_equal(np.asarray(known(loaded.truth).view_ids), labels)
    depths = np.asarray(known(loaded.camera).depth(known(loaded.truth).disparity))
    np.testing.assert_allclose(depths, depth[2, 2], rtol=1e-5)


def test_old_hci_depth_may_be_unknown_in_places(tmp_path):
    depth = np.full((3, 3, 6, 8), 5.0, np.float32)
    depth[1, 1, 2, 3] = 0
    truth = known(load_light_field(write_h5(tmp_path / "a.h5", random_views(), depth=depth)).truth)
    expected = np.ones((6, 8), bool)
    expected[2, 3] = False
    np.testing.assert_array_equal(np.asarray(truth.valid), expected)
    assert float(truth.disparity[2, 3]) == 0
    assert truth.view_disparity is None
    assert truth.object_ids is None


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("LF", random_views((3, 3, 6, 8)), r"4 dimensions \(shape \(3, 3, 6, 8\)\); expected 5"),
        ("LF", random_views((3, 3, 6, 8, 2)), "2 colour channels"),
        ("LF", random_views().astype(np.float32), "float32; expected uint8"),
        ("LF", None, "holds no array `LF`.*GT_DEPTH"),
        ("GT_DEPTH", np.full((6, 8), 5.0), "`GT_DEPTH`.*2 dimensions"),
        ("GT_DEPTH", np.full((3, 3, 6, 7), 5.0), r"`GT_DEPTH`.*\(3, 3, 6, 7\); expected"),
        ("GT_DEPTH", np.full((3, 3, 6, 8), np.nan), "GT_DEPTH holds 432 values that are NaN"),
        ("GT_DEPTH", np.zeros((3, 3, 6, 8)), "no positive value"),
        ("GT_LABELS", np.zeros((3, 6, 8)), "`GT_LABELS`.*3 dimensions"),
    ],
)
def test_old_hci_errors(tmp_path, name, value, text):
    path = write_h5(tmp_path / "bad.h5", random_views(), depth=np.full((3, 3, 6, 8), 5.0))
    with h5py.File(path, "a") as file:
        if name in file:
            del file[name]
        if value is not None:
            file[name] = value
    with pytest.raises(ValueError, match=text) as caught:
        load_light_field(path)
    assert "bad.h5" in str(caught.value)


def test_old_hci_depth_without_its_constants(tmp_path):
    path = write_h5(tmp_path / "bad.h5", random_views(), depth=np.full((3, 3, 6, 8), 5.0))
    with h5py.File(path, "a") as file:
        del file.attrs["shift"]
    with pytest.raises(ValueError, match="lacks the attribute shift"):
        load_light_field(path)


@pytest.mark.parametrize("version", ["7", "7.3"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_lytro_pixels(tmp_path, version, dtype, channels):
    views = random_views((3, 3, 4, 6, channels), dtype)
    loaded = load_light_field(write_mat(tmp_path / "a.mat", views, version=version))
    expected = np.broadcast_to(views[..., :3], (*views.shape[:4], 3)).astype(np.float32)
    np.testing.assert_array_equal(
        np.asarray(loaded.views), expected / np.float32(np.iinfo(dtype).max)
    )


@pytest.mark.parametrize("version", ["7", "7.3"])
@pytest.mark.parametrize(
    ("array", "text"),
    [
        (random_views((3, 3, 6, 8)), "4 dimensions .*expected 5"),
        (random_views((3, 3, 6, 8, 2)), "2 channels"),
        (random_views() / 255, "float64; expected uint8 or uint16"),
    ],
)
def test_lytro_errors(tmp_path, version, array, text):
    path = write_mat(tmp_path / "bad.mat", array, version=version)
    with pytest.raises(ValueError, match=text) as caught:
        load_light_field(path)
    assert "bad.mat" in str(caught.value)


def _write_by_h5py(path, array):
    """Without MATLAB's header, and the axes as they are."""
    with h5py.File(path, "w") as file:
        file["LF"] = array
    return path


@pytest.mark.parametrize("write", [write_mat, partial(write_mat, version="7.3"), _write_by_h5py])
@pytest.mark.parametrize("grid", [3, 5])
@pytest.mark.parametrize("grid_last", [False, True])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_the_order_of_the_axes_is_told_by_their_lengths(tmp_path, write, grid, grid_last, channels):
    views = random_views((grid, grid, 16, 21, channels))
    stored = views.transpose(2, 3, 0, 1, 4) if grid_last else views
    loaded = load_light_field(write(tmp_path / "a.mat", stored))
    expected = np.broadcast_to(views[..., :3], (grid, grid, 16, 21, 3)).astype(np.float32)
    np.testing.assert_array_equal(np.asarray(loaded.views), expected / np.float32(255))


@pytest.mark.parametrize("version", ["7", "7.3"])
@pytest.mark.parametrize("views", [None, 9])
def test_axes_that_could_be_either_are_named_both_ways(tmp_path, version, views):
    path = write_mat(tmp_path / "a.mat", random_views((15, 16, 9, 9, 3)), version=version)
    message = (
        r"either 15x16 views of 9x9 px, as \[v, u, y, x, c\], or 9x9 views of 15x16 px, as "
        r"\[y, x, v, u, c\]; expected"
    )
    with pytest.raises(ValueError, match=message):
        load_light_field(path, views=views)


def test_old_hci_with_its_axes_exchanged(tmp_path):
    path = write_h5(tmp_path / "a.h5", random_views((16, 21, 3, 3, 3)))
    with pytest.raises(ValueError, match=r"16x21 views of 3x3 px .*If it has 3x3 views of 16x21"):
        load_light_field(path)


@pytest.mark.parametrize("version", ["7", "7.3"])
def test_lytro_without_its_array(tmp_path, version):
    path = write_mat(tmp_path / "bad.mat", random_views(), version=version, name="other")
    with pytest.raises(ValueError, match=r"bad\.mat holds no array `LF` \(it has: other\)"):
        load_light_field(path)


@pytest.mark.parametrize("fraction", [0.0, 0.1, 0.7])
@pytest.mark.parametrize("kind", ["h5", "7", "7.3"])
def test_truncated_containers(tmp_path, kind, fraction):
    views = random_views((3, 3, 16, 16, 3))
    if kind == "h5":
        path = write_h5(tmp_path / "bad.h5", views)
    else:
        path = write_mat(tmp_path / "bad.mat", views, version=kind)
    cut(path, fraction)
    with pytest.raises(ValueError, match="truncated") as caught:
        load_light_field(path)
    assert path.name in str(caught.value)
