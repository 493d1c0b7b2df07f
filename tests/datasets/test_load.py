"""What all layouts share, and what each knows: values, options, memory layout, ground truth."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from datasets.layouts import (
    known,
    random_views,
    save_image,
    write_grid,
    write_h5,
    write_hci,
    write_mat,
    write_stanford,
)
from numpy.testing import assert_allclose, assert_array_equal

from mvedge_jax.datasets import load_light_field, write_pfm

DISPARITY = np.linspace(-1, 1, 48, dtype=np.float32).reshape(6, 8)


def write(layout, folder, views):
    """The views in one of `LAYOUTS`."""
    folder.mkdir(exist_ok=True)
    if layout == "hci":
        return write_hci(folder, views, settings=False)
    if layout == "stanford":
        return write_stanford(folder, views)
    if layout == "grid":
        return write_grid(folder, views)
    if layout == "h5":
        return write_h5(folder / "a.h5", views[:, ::-1])  # stored the other way round
    return write_mat(folder / "a.mat", views, version=layout.removeprefix("mat"))


LAYOUTS = ["hci", "stanford", "grid", "h5", "mat7", "mat7.3"]


def unit(views):
    """As light fields hold them."""
    return views.astype(np.float32) / np.float32(np.iinfo(views.dtype).max)


@pytest.fixture
def scene(tmp_path):
    """3x3 views in the HCI layout with settings and ground truth."""
    return write_hci(tmp_path / "toy", random_views(), disparity=DISPARITY)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_light_field(tmp_path, layout):
    views = random_views((5, 5, 4, 6, 3))
    path = write(layout, tmp_path / "scene", views)
    loaded = load_light_field(path)
    assert loaded.views.dtype == jnp.float32
    assert_array_equal(loaded.views, unit(views))
    assert loaded.available.all()
    assert loaded.truth is None
    middle = unit(views[1:4, 1:4])
    cases: list[tuple[dict[str, Any], Any]] = [
        ({"flip_u": True}, middle[:, ::-1]),
        ({"flip_v": True, "name": "other"}, middle[::-1]),
        ({"swap_axes": True, "flip_u": True}, middle.swapaxes(0, 1)[:, ::-1]),
    ]
    for options, expected in cases:
        found = load_light_field(path, views=3, **options)
        assert_array_equal(found.views, expected)
        assert found.name == options.get("name", loaded.name)
    for many in (2, 1, 7):
        with pytest.raises(ValueError, match="`views` must be odd, at least 3 and at most .* 5x5"):
            load_light_field(path, views=many)


@pytest.mark.parametrize("layout", ["stanford", "grid", "h5", "mat7", "mat7.3"])
@pytest.mark.parametrize("grid", [(3, 5), (4, 4)])
def test_grids_that_are_not_odd_squares(tmp_path, layout, grid):
    views = random_views((*grid, 4, 6, 3))
    path = write(layout, tmp_path / "scene", views)
    with pytest.raises(ValueError, match=f"{grid[0]}x{grid[1]} views.*odd square.*views=3") as e:
        load_light_field(path)
    assert "scene" in str(e.value) or "a (" in str(e.value)
    stored = views if layout != "h5" else views[:, ::-1]
    center = unit(stored[grid[0] // 2, grid[1] // 2])
    assert_array_equal(load_light_field(path, views=3).center_view, center)


@pytest.mark.parametrize("grid", [(1, 5), (5, 1)])
def test_a_single_row_or_column_of_views(tmp_path, grid):
    views = random_views((*grid, 4, 6, 3))
    path = write_hci(tmp_path / "scene", views)
    expected = unit(views)
    assert_array_equal(load_light_field(path).views, expected)
    middle = expected[:, 1:4] if grid[0] == 1 else expected[1:4]
    assert_array_equal(load_light_field(path, views=3).views, middle)
    assert load_light_field(path, swap_axes=True).views.shape[:2] == grid[::-1]
    with pytest.raises(ValueError, match="`views` must be odd"):
        load_light_field(path, views=7)
    with pytest.raises(ValueError, match="1x4 views.*an odd row or column.*views=3"):
        load_light_field(write_hci(tmp_path / "even", views.reshape(1, 5, 4, 6, 3)[:, :4]))


@pytest.mark.parametrize("suffix", ["jpg", "bmp"])
def test_other_formats(tmp_path, suffix):
    smooth = np.broadcast_to(random_views((3, 3, 1, 1, 3)), (3, 3, 16, 16, 3))
    loaded = load_light_field(write_grid(tmp_path, smooth, pattern=f"view_{{}}_{{}}.{suffix}"))
    assert_allclose(loaded.views, unit(smooth), atol=0 if suffix == "bmp" else 0.03)


def test_sixteen_bits_gray_and_alpha(tmp_path):
    deep, gray = random_views(dtype=np.uint16), random_views((3, 3, 6, 8))
    clear = random_views((3, 3, 6, 8, 4))
    # `save_image` reverses the channels: alpha first in memory is alpha last in the file.
    for name, stored, expected in (
        ("deep", deep, deep),
        ("gray", gray, np.repeat(gray[..., None], 3, axis=-1)),
        ("clear", clear[..., ::-1], clear[..., [2, 1, 0]]),
    ):
        loaded = load_light_field(write_grid(tmp_path / name, stored))
        assert_array_equal(loaded.views, unit(expected))


@pytest.mark.parametrize(
    ("pattern", "first"),
    [
        ("{:02d}_{:02d}.png", 0),
        ("{}_{}.png", 1),
        ("2067_{:02d}_{:02d}.png", 1),
        ("a-b_{:03d}_{:03d}.png", 4),
        ("im{}-{}.bmp", 0),
        ("x_{}_{}.PNG", 9),
    ],
)
def test_names_of_grids(tmp_path, pattern, first):
    views = random_views((3, 3, 4, 5, 3))
    loaded = load_light_field(write_grid(tmp_path, views, pattern=pattern, first=first))
    assert_array_equal(loaded.views, unit(views))


def test_folder_with_one_container_stands_for_it(tmp_path):
    write_mat(tmp_path / "Bikes.mat", random_views())
    (tmp_path / "readme.txt").write_text("")
    loaded = load_light_field(tmp_path)
    assert loaded.name == "Bikes"
    assert_array_equal(loaded.views, unit(random_views()))


def test_missing_views_are_told_and_not_invented(tmp_path):
    for layout in ("hci", "stanford", "grid"):
        folder = write(layout, tmp_path / layout, random_views())
        sorted(folder.glob("*.png"))[2].unlink()
        loaded = load_light_field(folder)
        assert_array_equal(loaded.available, [[True, True, False], [True] * 3, [True] * 3])
        assert not loaded.views[0, 2].any()


@pytest.mark.parametrize("side", [3, 5, 9])
def test_crosshair_alone_tells_the_grid(tmp_path, side):
    views = random_views((side, side, 4, 5, 3))
    write_hci(tmp_path, views, settings=False)
    middle = side // 2
    for number in range(side**2):
        if middle not in divmod(number, side):
            (tmp_path / f"input_Cam{number:03d}.png").unlink()
    loaded = load_light_field(tmp_path)
    assert loaded.views.shape[:2] == (side, side)
    assert int(loaded.available.sum()) == 2 * side - 1
    assert_array_equal(loaded.horizontal_arm, unit(views[middle]))
    assert_array_equal(loaded.vertical_arm, unit(views[:, middle]))


def test_everything_that_the_benchmark_knows(scene):
    ids = np.arange(48, dtype=np.uint16).reshape(6, 8) + 300
    save_image(scene / "objectids_lowres.png", ids)
    loaded = load_light_field(scene)
    truth, camera = known(loaded.truth), known(loaded.camera)
    assert loaded.name == "toy"
    assert_allclose(known(loaded.disparity_range), [-1.5, 1.25])
    assert truth.valid.all()
    assert_array_equal(truth.disparity, DISPARITY)
    assert_array_equal(truth.object_ids, ids)
    assert truth.view_disparity is None
    # focal length of the longer side, 8 px on 35 mm
    assert float(camera.focal_px) == pytest.approx(100 * 8 / 35)
    assert float(camera.baseline) == pytest.approx(0.025)
    expected = 1 / (DISPARITY / (100 * 8 / 35 * 0.025) + 1 / 4.25)
    seen = expected > 0
    assert_allclose(camera.depth(truth.disparity)[seen], expected[seen], rtol=1e-5)
    (scene / "parameters.cfg").write_text("[meta]\nscene = toy\n")
    partial = load_light_field(scene)
    assert (partial.camera, partial.disparity_range) == (None, None)


def test_ground_truth_of_every_view(scene):
    every = np.random.default_rng(0).normal(size=(3, 3, 6, 8)).astype(np.float32)
    for number in range(9):
        write_pfm(scene / f"gt_disp_lowres_Cam{number:03d}.pfm", every[divmod(number, 3)])
        save_image(scene / f"objectids_lowres_Cam{number:03d}.png", np.full((6, 8), number, "u1"))
    write_pfm(scene / "gt_disp_lowres.pfm", every[1, 1])
    truth = known(load_light_field(scene, flip_v=True).truth)
    assert_array_equal(truth.view_disparity, every[::-1])
    assert_array_equal(known(truth.view_ids)[:, 0, 2, 3], [6, 3, 0])
    assert_array_equal(truth.object_ids, 4)
    turned = known(load_light_field(scene, swap_axes=True).truth)
    assert_array_equal(turned.disparity, truth.disparity)
    assert_array_equal(turned.view_disparity, every.swapaxes(0, 1))
    assert_array_equal(known(turned.view_ids)[:, 0, 2, 3], [0, 1, 2])
    (scene / "gt_disp_lowres.pfm").unlink()
    small = known(load_light_field(scene, scale=0.5).truth)
    expected = every[1, 1].reshape(3, 2, 4, 2).mean((1, 3)) / 2
    assert_allclose(small.disparity, expected, atol=1e-6)
    assert_allclose(known(small.view_disparity)[1, 1], expected, atol=1e-6)
    write_pfm(scene / "gt_disp_lowres_Cam007.pfm", every[0, 0, :5])
    with pytest.raises(ValueError, match=r"gt_disp_lowres_Cam007\.pfm has the size \(5, 8\)"):
        load_light_field(scene)


def test_scale_averages_areas_and_shrinks_what_is_in_pixels(tmp_path):
    views = random_views((3, 3, 7, 10, 3))
    disparity = np.full((7, 10), 0.5, np.float32)
    disparity[:, :2] = 1.0
    path = write_hci(tmp_path / "scene", views, disparity=disparity)
    loaded, whole = load_light_field(path, scale=0.5), load_light_field(path).downsample(2)
    areas = views[:, :, :6].astype(np.float64).reshape(3, 3, 3, 2, 5, 2, 3).mean((3, 5)) / 255
    assert_allclose(loaded.views, areas, atol=1e-6)
    small = known(loaded.truth).disparity
    assert_allclose(small, np.broadcast_to([0.5, *[0.25] * 4], (3, 5)))
    for found, same in zip(jax.tree.leaves(loaded), jax.tree.leaves(whole), strict=True):
        assert_allclose(found, same, atol=1e-6)
    given = load_light_field(path, disparity_range=(-2.0, 3.0), scale=0.5)
    assert_allclose(known(given.disparity_range), [-1.0, 1.5])
