"""What all layouts share: values, options, memory layout."""

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

from mvedge_jax.datasets import load_light_field


def _write(layout, folder, views):
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


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_light_field(tmp_path, layout):
    views = random_views((5, 5, 6, 9, 3))
    loaded = load_light_field(_write(layout, tmp_path / "scene", views))
    assert loaded.views.dtype == jnp.float32
    np.testing.assert_array_equal(np.asarray(loaded.views), views.astype(np.float32) / 255)
    assert loaded.available.all()
    assert loaded.truth is None


@pytest.mark.parametrize("layout", LAYOUTS)
def test_central_views_and_flips(tmp_path, layout):
    views = random_views((5, 5, 4, 6, 3))
    path = _write(layout, tmp_path / "scene", views)
    loaded = load_light_field(path, views=3, flip_u=True)
    expected = views[1:4, 1:4][:, ::-1].astype(np.float32) / 255
    np.testing.assert_array_equal(np.asarray(loaded.views), expected)
    loaded = load_light_field(path, views=3, flip_v=True, name="other")
    np.testing.assert_array_equal(
        np.asarray(loaded.views), views[1:4, 1:4][::-1].astype(np.float32) / 255
    )
    assert loaded.name == "other"
    loaded = load_light_field(path, views=3, swap_axes=True, flip_u=True)
    expected = views[1:4, 1:4].swapaxes(0, 1)[:, ::-1].astype(np.float32) / 255
    np.testing.assert_array_equal(np.asarray(loaded.views), expected)


def test_exchanged_axes_take_the_truth_of_every_view_along(tmp_path):
    views = random_views((3, 3, 6, 8, 3))
    depth = np.linspace(5, 9, 9 * 48, dtype=np.float32).reshape(3, 3, 6, 8)
    path = write_h5(tmp_path / "a.h5", views, depth=depth, labels=random_views((3, 3, 6, 8)))
    one, other = (known(load_light_field(path, swap_axes=swap).truth) for swap in (False, True))
    np.testing.assert_array_equal(one.disparity, other.disparity)
    for name in ("view_disparity", "view_ids"):
        maps = known(getattr(one, name)), known(getattr(other, name))
        np.testing.assert_array_equal(maps[0], maps[1].swapaxes(0, 1))


def test_exchanged_axes_may_be_a_single_row(tmp_path):
    folder = write_grid(tmp_path / "toy", random_views((1, 5, 6, 8, 3)))
    assert load_light_field(folder, swap_axes=True).views.shape[:2] == (5, 1)


@pytest.mark.parametrize("views", [2, 1, 7])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_bad_number_of_views(tmp_path, layout, views):
    path = _write(layout, tmp_path / "scene", random_views((5, 5, 4, 6, 3)))
    with pytest.raises(ValueError, match="`views` must be odd, at least 3 and at most .* 5x5"):
        load_light_field(path, views=views)


@pytest.mark.parametrize("layout", ["stanford", "grid", "h5", "mat7", "mat7.3"])
@pytest.mark.parametrize("grid", [(3, 5), (4, 4)])
def test_grids_that_are_not_odd_squares(tmp_path, layout, grid):
    views = random_views((*grid, 4, 6, 3))
    path = _write(layout, tmp_path / "scene", views)
    with pytest.raises(ValueError, match=f"{grid[0]}x{grid[1]} views.*odd square.*views=3") as e:
        load_light_field(path)
    assert "scene" in str(e.value) or "a (" in str(e.value)
    centre = grid[0] // 2, grid[1] // 2
    loaded = load_light_field(path, views=3)
    stored = views if layout != "h5" else views[:, ::-1]
    expected = np.asarray(stored[centre], np.float32) / 255
    np.testing.assert_array_equal(np.asarray(loaded.centre_view), expected)


def test_non_square_grid_of_the_hci_layout(tmp_path):
    path = write_hci(tmp_path / "scene", random_views((3, 5, 4, 6, 3)))
    with pytest.raises(ValueError, match="3x5 views"):
        load_light_field(path)


@pytest.mark.parametrize("grid", [(1, 5), (5, 1)])
def test_a_single_row_or_column_of_views(tmp_path, grid):
    views = random_views((*grid, 4, 6, 3))
    path = write_hci(tmp_path / "scene", views)
    expected = views.astype(np.float32) / 255
    np.testing.assert_array_equal(np.asarray(load_light_field(path).views), expected)
    middle = expected[:, 1:4] if grid[0] == 1 else expected[1:4]
    np.testing.assert_array_equal(np.asarray(load_light_field(path, views=3).views), middle)
    with pytest.raises(ValueError, match="`views` must be odd"):
        load_light_field(path, views=7)
    with pytest.raises(ValueError, match="1x4 views.*an odd row or column.*views=3"):
        load_light_field(write_hci(tmp_path / "even", views.reshape(1, 5, 4, 6, 3)[:, :4]))


def test_scale_averages_areas_and_shrinks_what_is_in_pixels(tmp_path):
    views = random_views((3, 3, 7, 10, 3))
    disparity = np.full((7, 10), 0.5, np.float32)
    disparity[:, :2] = 1.0
    path = write_hci(tmp_path / "scene", views, disparity=disparity)
    loaded = load_light_field(path, scale=0.5)
    areas = views[:, :, :6].astype(np.float64).reshape(3, 3, 3, 2, 5, 2, 3).mean((3, 5)) / 255
    np.testing.assert_allclose(np.asarray(loaded.views), areas, atol=1e-6)
    np.testing.assert_allclose(np.asarray(loaded.disparity_range), [-0.75, 0.625])
    whole = load_light_field(path)
    np.testing.assert_allclose(np.asarray(known(loaded.truth).disparity[:, 1:]), 0.25)
    np.testing.assert_allclose(np.asarray(known(loaded.truth).disparity[:, 0]), 0.5)
    near = jnp.asarray(0.25, jnp.float32)
    # The same thing is as far away in either light field.
    assert float(known(loaded.camera).depth(near)) == pytest.approx(
        float(known(whole.camera).depth(2 * near))
    )
    same = whole.downsample(2)
    np.testing.assert_allclose(np.asarray(same.views), np.asarray(loaded.views), atol=1e-6)
    np.testing.assert_allclose(
        np.asarray(known(same.truth).disparity),
        np.asarray(known(loaded.truth).disparity),
        atol=1e-6,
    )


@pytest.mark.parametrize("scale", [0.0, -1.0, 1.5])
def test_bad_scale(tmp_path, scale):
    with pytest.raises(ValueError, match=r"`scale` must be in \(0, 1\]"):
        load_light_field(tmp_path, scale=scale)


@pytest.mark.parametrize("scale", [1e-320, 1e-30, 0.12])
def test_a_scale_that_leaves_no_pixel(tmp_path, scale):
    path = write_grid(tmp_path, random_views((3, 3, 8, 8, 3)))
    with pytest.raises(
        ValueError, match=r"leaves no pixel of .*02_02\.png, 8x8 px .* at least 0\.1"
    ):
        load_light_field(path, scale=scale)


def test_a_range_that_is_given_wins(tmp_path):
    path = write_hci(tmp_path / "scene", random_views())
    loaded = load_light_field(path, disparity_range=(-2.0, 3.0), scale=0.5)
    np.testing.assert_allclose(np.asarray(loaded.disparity_range), [-1.0, 1.5])


def test_folder_with_one_container_stands_for_it(tmp_path):
    views = random_views()
    write_mat(tmp_path / "Bikes.mat", views)
    (tmp_path / "readme.txt").write_text("")
    loaded = load_light_field(tmp_path)
    assert loaded.name == "Bikes"
    np.testing.assert_array_equal(np.asarray(loaded.views), views.astype(np.float32) / 255)


def test_nothing_to_load(tmp_path):
    with pytest.raises(FileNotFoundError, match="an empty folder; expected input_CamNNN.png"):
        load_light_field(tmp_path)
    (tmp_path / "notes.txt").write_text("")
    with pytest.raises(FileNotFoundError, match=r"1 files, such as notes\.txt"):
        load_light_field(tmp_path)
    with pytest.raises(ValueError, match=r"notes\.txt is not a light field"):
        load_light_field(tmp_path / "notes.txt")
    with pytest.raises(FileNotFoundError, match="nowhere is not there"):
        load_light_field(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    write_grid(tmp_path / "one", random_views())
    itself = "holds no light field itself, but "
    with pytest.raises(FileNotFoundError, match=itself + "one in it is one: name that"):
        load_light_field(tmp_path)
    (tmp_path / "two").mkdir()
    write_mat(tmp_path / "two" / "a.mat", random_views())
    with pytest.raises(FileNotFoundError, match=itself + "2 in it: one, two; name one of them"):
        load_light_field(tmp_path)
    for name in ("a.mat", "b.mat", "c.mat"):
        write_mat(tmp_path / name, random_views())
    with pytest.raises(FileNotFoundError, match=r"3 in it: a\.mat, b\.mat, c\.mat; name one"):
        load_light_field(tmp_path)
    save_image(tmp_path / "photo_2020_1.png", random_views()[0, 0])
    with pytest.raises(ValueError, match="grid of 1x1 views"):
        load_light_field(tmp_path)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="an accelerator has its own memory")
def test_views_are_adopted_without_a_copy(tmp_path, monkeypatch):
    from mvedge_jax.datasets import _read

    made = []
    original = _read._aligned_zeros
    monkeypatch.setattr(
        _read, "_aligned_zeros", lambda shape: made.append(original(shape)) or made[-1]
    )
    loaded = load_light_field(write_grid(tmp_path, random_views((3, 3, 32, 32, 3))))
    assert loaded.views.unsafe_buffer_pointer() == made[0].ctypes.data
