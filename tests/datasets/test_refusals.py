"""What is no light field, and what contradicts itself in one, is refused and named."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from datasets.layouts import (
    cut,
    random_views,
    save_image,
    write_grid,
    write_hci,
    write_mat,
    write_stanford,
)

from mvedge_jax.datasets import load_light_field, write_pfm


def refused(path, match, kind: type[Exception] = ValueError, **options):
    """The message of an error that matches."""
    with pytest.raises(kind, match=match) as caught:
        load_light_field(path, **options)
    return str(caught.value)


def other_pixels(file, *, shape=(6, 8, 3), dtype: type = np.uint8):
    save_image(file, random_views((1, 1, *shape), dtype)[0, 0])


def flipped_byte(file):
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(bytes(data))


@pytest.mark.parametrize("write", [write_hci, write_stanford, write_grid])
@pytest.mark.parametrize(
    ("place", "damage", "match"),
    [
        ((1, 2), Path.unlink, "is missing.*crosshair.*1 of 5"),
        *(((0, 1), partial(cut, fraction=f), "truncated|empty") for f in (0.0, 0.3, 0.7, 0.99)),
        ((2, 1), flipped_byte, "checksum is wrong"),
        ((2, 1), partial(Path.write_text, data="hello"), "cannot be decoded"),
        ((0, 0), partial(other_pixels, shape=(5, 8, 3)), "5x8 px .* expected 6x8"),
        ((0, 0), partial(other_pixels, dtype=np.uint16), "uint16; expected 6x8 of uint8"),
    ],
)
def test_a_view_that_is_damaged(tmp_path, write, place, damage, match):
    files = sorted(write(tmp_path / "scene", random_views()).glob("*.png"))
    broken = files[3 * place[0] + place[1]]
    damage(broken)
    kind = ValueError if broken.exists() else FileNotFoundError
    said = refused(tmp_path / "scene", match, kind)
    hidden = write is write_stanford and not broken.exists()  # its name says where the camera is
    assert ("out_01_02_<y>_<x>.png" if hidden else broken.name) in said
    assert "5x8" not in match or files[4].name in said


@pytest.mark.parametrize("suffix", ["jpg", "bmp"])
def test_a_view_of_another_format_that_is_truncated(tmp_path, suffix):
    folder = write_grid(tmp_path, random_views(), pattern=f"view_{{}}_{{}}.{suffix}")
    cut(folder / f"view_2_1.{suffix}", 0.8)
    refused(folder, rf"view_2_1\.{suffix} cannot be read: it is truncated")


TRUTH = np.zeros((6, 8), np.float32)
NAN = np.where(np.arange(48).reshape(6, 8) == 19, np.float32(np.nan), TRUTH)


@pytest.mark.parametrize(
    ("name", "spoil", "match"),
    [
        (
            "gt_disp_lowres.pfm",
            partial(write_pfm, array=NAN),
            r"lowres\.pfm holds 1 values.*at \(2, 3\)",
        ),
        (
            "gt_disp_lowres.pfm",
            partial(write_pfm, array=TRUTH[:5]),
            r"5x8 px .* expected 6x8, as .*input_Cam004\.png",
        ),
        ("gt_disp_lowres.pfm", cut, r"gt_disp_lowres\.pfm is truncated"),
        (
            "objectids_lowres.png",
            partial(other_pixels, shape=(6, 7)),
            r"objectids_lowres\.png has the shape \(6, 7\)",
        ),
        ("input_Cam003.bmp", other_pixels, r"input_Cam003\.png and .*input_Cam003\.bmp are both"),
    ],
)
def test_files_of_the_benchmark_that_contradict(tmp_path, name, spoil, match):
    scene = write_hci(tmp_path / "toy", random_views(), disparity=TRUTH)
    spoil(scene / name)
    refused(scene, match)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("focal_length_mm = 100.0", "focal_length_mm = long", "focal_length_mm = 'long'"),
        ("baseline_mm = 25.0", "baseline_mm = -1", "must give positive"),
        ("num_cams_x = 3", "num_cams_x = 2.5", "promises 3 x 2.5 cameras"),
        ("num_cams_x = 3", "num_cams_x = 2", "lies outside the grid of 3x2 views"),
        ("_x_px = 8", "_x_px = 9", "6x8 px .* expected 6x9, as .*parameters.cfg"),
        ("disp_min = -1.5", "disp_min = 1.5", "disp_min = 1.5 and disp_max = 1.25"),
        ("[intrinsics]", "meta\n[intrinsics]", "cannot be read as a configuration"),
    ],
)
def test_settings_that_contradict(tmp_path, old, new, match):
    scene = write_hci(tmp_path / "toy", random_views())
    file = scene / "parameters.cfg"
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))
    assert str(scene) in refused(scene, match)


def test_grids_that_do_not_fit(tmp_path):
    refused(write_hci(tmp_path / "hci", random_views((3, 5, 4, 6, 3))), "3x5 views")
    folder = write_grid(tmp_path / "names", random_views(), pattern="s_{:03d}_{}.png", first=1)
    (folder / "s_002_3.png").unlink()
    refused(folder, r"s_002_3\.png is missing", FileNotFoundError)
    folder = write_grid(tmp_path / "two", random_views(), pattern="a_{}_{}.png")
    write_grid(folder, random_views(), pattern="depth_{}_{}.png")
    refused(folder, "'a_RR_CC.png', 'depth_RR_CC.png'")
    folder = write_grid(tmp_path / "twice", random_views(), pattern="a_{}_{}.png")
    other_pixels(folder / "a_01_1.png")
    refused(folder, "are both row 1, column 1")
    (folder / "a_01_1.png").rename(folder / "a_2_900000.png")
    refused(folder, "without large gaps")


def test_nothing_to_load(tmp_path):
    missing = partial(refused, kind=FileNotFoundError)
    missing(tmp_path, "an empty folder; expected input_CamNNN.png")
    (tmp_path / "notes.txt").write_text("")
    missing(tmp_path, r"1 files, such as notes\.txt")
    refused(tmp_path / "notes.txt", r"notes\.txt is not a light field")
    missing(tmp_path / "nowhere", "nowhere is not there")
    (tmp_path / "empty").mkdir()
    write_grid(tmp_path / "one", random_views())
    itself = "holds no light field itself, but "
    missing(tmp_path, itself + "one in it is one: name that")
    (tmp_path / "two").mkdir()
    write_mat(tmp_path / "two" / "a.mat", random_views())
    missing(tmp_path, itself + "2 in it: one, two; name one of them")
    for name in ("a.mat", "b.mat", "c.mat"):
        write_mat(tmp_path / name, random_views())
    missing(tmp_path, r"3 in it: a\.mat, b\.mat, c\.mat; name one")
    other_pixels(tmp_path / "photo_2020_1.png")
    refused(tmp_path, "grid of 1x1 views")


def test_two_stanford_images_of_one_view(tmp_path):
    twice = write_stanford(tmp_path / "twice", random_views())
    other_pixels(twice / "out_00_00_1_2.png")
    refused(twice, "are both row 0, column 0")
