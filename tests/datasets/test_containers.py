"""HDF5 and MATLAB files."""

from functools import partial

import h5py
import numpy as np
import pytest
from cli.scenes import textured_plane
from datasets.layouts import cut, known, random_views, write_h5, write_mat
from numpy.testing import assert_allclose, assert_array_equal

from mvedge_jax.datasets import load_light_field

DEPTH = np.full((3, 3, 6, 8), 5.0, np.float32)
V73 = partial(write_mat, version="7.3")


@pytest.mark.parametrize("direction_v", [1, -1])
@pytest.mark.parametrize("direction_u", [1, -1])
def test_old_hci_is_put_in_the_order_of_its_ground_truth(tmp_path, direction_v, direction_u):
    disparity = 2
    whole = textured_plane(24, 24, disparity=disparity, grid=(5, 5))
    views = whole[::direction_v, ::direction_u]
    depth = np.full(views.shape[:4], 0.1 * 600 / (disparity + 10), np.float32)
    labels = np.broadcast_to(np.arange(24, dtype=np.uint8), views.shape[:4])
    loaded = load_light_field(write_h5(tmp_path / "buddha.h5", views, depth=depth, labels=labels))
    truth = known(loaded.truth)
    assert loaded.name == "buddha"
    assert_array_equal(loaded.views, whole.astype(np.float32) / 255)
    assert_allclose(truth.disparity, disparity, rtol=1e-5)
    assert_allclose(known(truth.view_disparity), disparity, rtol=1e-5)
    assert_array_equal(truth.object_ids, labels[0, 0])
    assert_array_equal(truth.view_ids, labels)
    assert_allclose(known(loaded.camera).depth(truth.disparity), depth[2, 2], rtol=1e-5)


def test_old_hci_depth_may_be_unknown_in_places(tmp_path):
    depth = DEPTH.copy()
    depth[1, 1, 2, 3] = 0
    truth = known(load_light_field(write_h5(tmp_path / "a.h5", random_views(), depth=depth)).truth)
    assert_array_equal(truth.valid, depth[1, 1] > 0)
    assert float(truth.disparity[2, 3]) == 0
    assert truth.view_disparity is None
    assert truth.object_ids is None


def _write_by_h5py(path, array):
    """Without MATLAB's header, and the axes as they are."""
    with h5py.File(path, "w") as file:
        file["LF"] = array
    return path


@pytest.mark.parametrize("write", [write_mat, V73, _write_by_h5py])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("grid_last", [False, True])
@pytest.mark.parametrize(("grid", "channels"), [(3, 1), (3, 3), (5, 4)])
def test_pixels_whose_axes_are_told_by_their_lengths(
    tmp_path, write, dtype, grid_last, grid, channels
):
    views = random_views((grid, grid, 16, 21, channels), dtype)
    stored = views.transpose(2, 3, 0, 1, 4) if grid_last else views
    loaded = load_light_field(write(tmp_path / "a.mat", stored))
    expected = np.broadcast_to(views[..., :3], (grid, grid, 16, 21, 3)).astype(np.float32)
    assert_array_equal(loaded.views, expected / np.float32(np.iinfo(dtype).max))


EITHER = (
    r"either 15x16 views of 9x9 px, as \[v, u, y, x, c\], or 9x9 views of 15x16 px, as "
    r"\[y, x, v, u, c\]; expected"
)


@pytest.mark.parametrize("write", [write_mat, V73])
@pytest.mark.parametrize(
    ("array", "options", "text"),
    [
        (random_views((3, 3, 6, 8)), {}, "4 dimensions .*expected 5"),
        (random_views((3, 3, 6, 8, 2)), {}, "2 channels"),
        (random_views() / 255, {}, "float64; expected uint8 or uint16"),
        (random_views((15, 16, 9, 9, 3)), {}, EITHER),
        (random_views((15, 16, 9, 9, 3)), {"views": 9}, EITHER),
        (None, {}, r"holds no array `LF` \(it has: other\)"),
    ],
)
def test_lytro_errors(tmp_path, write, array, options, text):
    path = tmp_path / "bad.mat"
    if array is None:
        write(path, random_views(), name="other")
    else:
        write(path, array)
    with pytest.raises(ValueError, match=text) as caught:
        load_light_field(path, **options)
    assert "bad.mat" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("LF", random_views((3, 3, 6, 8)), r"4 dimensions \(shape \(3, 3, 6, 8\)\); expected 5"),
        ("LF", random_views((3, 3, 6, 8, 2)), "2 color channels"),
        ("LF", random_views().astype(np.float32), "float32; expected uint8"),
        ("LF", random_views((16, 21, 3, 3, 3)), "views of 3x3 px .*If it has 3x3 views of 16x21"),
        ("LF", None, "holds no array `LF`.*GT_DEPTH"),
        ("GT_DEPTH", DEPTH[0, 0], "`GT_DEPTH`.*2 dimensions"),
        ("GT_DEPTH", DEPTH[..., :7], r"`GT_DEPTH`.*\(3, 3, 6, 7\); expected"),
        ("GT_DEPTH", np.nan * DEPTH, "GT_DEPTH holds 432 values that are NaN"),
        ("GT_DEPTH", 0 * DEPTH, "no positive value"),
        ("GT_LABELS", 0 * DEPTH[0], "`GT_LABELS`.*3 dimensions"),
        ("shift", None, "lacks the attribute shift"),
    ],
)
def test_old_hci_errors(tmp_path, name, value, text):
    path = write_h5(tmp_path / "bad.h5", random_views(), depth=DEPTH)
    with h5py.File(path, "a") as file:
        for of in (file, file.attrs):
            if name in of:
                del of[name]
        if value is not None:
            file[name] = value
    with pytest.raises(ValueError, match=text) as caught:
        load_light_field(path)
    assert "bad.h5" in str(caught.value)


@pytest.mark.parametrize("fraction", [0.0, 0.1, 0.7])
@pytest.mark.parametrize("write", [write_h5, write_mat, V73])
def test_truncated_containers(tmp_path, write, fraction):
    path = write(tmp_path / f"bad.{'h5' if write is write_h5 else 'mat'}", random_views())
    cut(path, fraction)
    with pytest.raises(ValueError, match="truncated") as caught:
        load_light_field(path)
    assert path.name in str(caught.value)
