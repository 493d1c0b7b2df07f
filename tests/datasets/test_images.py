"""Image folders: kinds of pixels, incomplete grids, and every way a file can be wrong."""

import numpy as np
import pytest
from datasets.layouts import (
    cut,
    random_views,
    save_image,
    write_grid,
    write_hci,
    write_stanford,
)

from mvedge_jax.datasets import load_light_field

FOLDERS = {
    "hci": (write_hci, "input_Cam{:03d}.png".format),
    "stanford": (write_stanford, None),
    "grid": (write_grid, None),
}


@pytest.fixture(params=FOLDERS)
def folder(request, tmp_path):
    """A 3x3 light field in each of the image layouts."""
    return FOLDERS[request.param][0](tmp_path / "scene", random_views((3, 3, 6, 8, 3)))


def _view(folder, row, column):
    images = sorted(folder.glob("*.png"))
    assert len(images) == 9
    return images[3 * row + column]


def test_missing_view_of_the_crosshair(folder):
    missing = _view(folder, 1, 2)
    missing.unlink()
    with pytest.raises(FileNotFoundError, match="is missing.*crosshair.*1 of 5") as caught:
        load_light_field(folder)
    name = missing.name if "out_" not in missing.name else "out_01_02_<y>_<x>.png"
    assert name in str(caught.value)


def test_missing_corner_is_reported_not_invented(folder):
    _view(folder, 0, 2).unlink()
    loaded = load_light_field(folder)
    np.testing.assert_array_equal(
        np.asarray(loaded.available), [[True, True, False], [True] * 3, [True] * 3]
    )
    assert not loaded.views[0, 2].any()


@pytest.mark.parametrize("fraction", [0.0, 0.3, 0.7, 0.99])
def test_truncated_png(folder, fraction):
    broken = _view(folder, 0, 1)
    cut(broken, fraction)
    with pytest.raises(ValueError, match="truncated|empty") as caught:
        load_light_field(folder)
    assert broken.name in str(caught.value)


def test_damaged_png(folder):
    broken = _view(folder, 2, 1)
    data = bytearray(broken.read_bytes())
    data[len(data) // 2] ^= 0xFF
    broken.write_bytes(bytes(data))
    with pytest.raises(ValueError, match="checksum is wrong") as caught:
        load_light_field(folder)
    assert broken.name in str(caught.value)


def test_not_an_image(folder):
    _view(folder, 2, 1).write_text("hello")
    with pytest.raises(ValueError, match="cannot be decoded") as caught:
        load_light_field(folder)
    assert _view(folder, 2, 1).name in str(caught.value)


def test_mixed_sizes(folder):
    save_image(_view(folder, 0, 0), random_views((1, 1, 5, 8, 3))[0, 0])
    with pytest.raises(ValueError, match="5x8 px .* expected 6x8") as caught:
        load_light_field(folder)
    assert _view(folder, 0, 0).name in str(caught.value)
    assert _view(folder, 1, 1).name in str(caught.value)


def test_mixed_depths(folder):
    save_image(_view(folder, 0, 0), random_views((1, 1, 6, 8, 3), np.uint16)[0, 0])
    with pytest.raises(ValueError, match="uint16; expected 6x8 of uint8"):
        load_light_field(folder)


@pytest.mark.parametrize("suffix", ["jpg", "bmp"])
def test_other_formats(tmp_path, suffix):
    smooth = np.broadcast_to(random_views((3, 3, 1, 1, 3)), (3, 3, 16, 16, 3))
    folder = write_grid(tmp_path, smooth, pattern=f"view_{{}}_{{}}.{suffix}")
    loaded = np.asarray(load_light_field(folder).views)
    np.testing.assert_allclose(loaded, smooth / 255, atol=0 if suffix == "bmp" else 0.03)
    cut(folder / f"view_2_1.{suffix}", 0.8)
    with pytest.raises(ValueError, match=rf"view_2_1\.{suffix} cannot be read: it is truncated"):
        load_light_field(folder)


def test_sixteen_bits_grey_and_alpha(tmp_path):
    deep = random_views(dtype=np.uint16)
    loaded = load_light_field(write_grid(tmp_path / "deep", deep))
    np.testing.assert_array_equal(np.asarray(loaded.views), deep.astype(np.float32) / 65535)
    grey = random_views((3, 3, 6, 8))
    loaded = load_light_field(write_grid(tmp_path / "grey", grey))
    expected = np.repeat(grey[..., None], 3, axis=-1).astype(np.float32) / 255
    np.testing.assert_array_equal(np.asarray(loaded.views), expected)
    clear = random_views((3, 3, 6, 8, 4))
    # save_image reverses the channels: alpha first in memory is alpha last in the file
    loaded = load_light_field(write_grid(tmp_path / "clear", clear[..., [0, 1, 2, 3]][..., ::-1]))
    expected = clear[..., [2, 1, 0]].astype(np.float32) / 255
    np.testing.assert_array_equal(np.asarray(loaded.views), expected)


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
    np.testing.assert_array_equal(np.asarray(loaded.views), views.astype(np.float32) / 255)


def test_error_names_the_file_as_the_others_are_named(tmp_path):
    folder = write_grid(tmp_path, random_views(), pattern="s_{:03d}_{}.png", first=1)
    (folder / "s_002_3.png").unlink()
    with pytest.raises(FileNotFoundError, match=r"s_002_3\.png is missing"):
        load_light_field(folder)


def test_two_grids_in_a_folder(tmp_path):
    folder = write_grid(tmp_path, random_views(), pattern="a_{}_{}.png")
    write_grid(tmp_path, random_views(), pattern="depth_{}_{}.png")
    with pytest.raises(ValueError, match="'a_RR_CC.png', 'depth_RR_CC.png'"):
        load_light_field(folder)
    other = write_grid(tmp_path / "twice", random_views(), pattern="a_{}_{}.png")
    save_image(other / "a_01_1.png", random_views()[0, 0])
    with pytest.raises(ValueError, match="are both row 1, column 1"):
        load_light_field(other)
    save_image(tmp_path / "twice" / "a_2_900000.png", random_views()[0, 0])
    (other / "a_01_1.png").unlink()
    with pytest.raises(ValueError, match="without large gaps"):
        load_light_field(other)


def test_two_stanford_images_of_one_view(tmp_path):
    folder = write_stanford(tmp_path / "twice", random_views())
    save_image(folder / "out_00_00_1_2.png", random_views()[0, 0])
    with pytest.raises(ValueError, match="are both row 0, column 0"):
        load_light_field(folder)
