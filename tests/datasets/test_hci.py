import numpy as np
import pytest
from datasets.layouts import cut, known, random_views, save_image, write_hci

from mvedge_jax.datasets import load_light_field, write_pfm


@pytest.fixture
def scene(tmp_path):
    """3x3 views with settings and ground truth."""
    disparity = np.linspace(-1, 1, 48, dtype=np.float32).reshape(6, 8)
    return write_hci(tmp_path / "toy", random_views(), disparity=disparity)


def test_everything_that_the_benchmark_knows(scene):
    ids = np.arange(48, dtype=np.uint16).reshape(6, 8) + 300
    save_image(scene / "objectids_lowres.png", ids)
    loaded = load_light_field(scene)
    assert loaded.name == "toy"
    np.testing.assert_allclose(np.asarray(loaded.disparity_range), [-1.5, 1.25])
    assert known(loaded.truth).valid.all()
    np.testing.assert_array_equal(
        np.asarray(known(loaded.truth).disparity),
        np.linspace(-1, 1, 48).reshape(6, 8).astype(np.float32),
    )
    np.testing.assert_array_equal(np.asarray(known(loaded.truth).object_ids), ids)
    assert known(loaded.truth).view_disparity is None
    # focal length of the longer side, 8 px on 35 mm
    assert float(known(loaded.camera).focal_px) == pytest.approx(100 * 8 / 35)
    assert float(known(loaded.camera).baseline) == pytest.approx(0.025)
    depth = np.asarray(known(loaded.camera).depth(known(loaded.truth).disparity))
    expected = 1 / (np.asarray(known(loaded.truth).disparity) / (100 * 8 / 35 * 0.025) + 1 / 4.25)
    np.testing.assert_allclose(depth[expected > 0], expected[expected > 0], rtol=1e-5)


def test_ground_truth_of_every_view(scene):
    every = np.random.default_rng(0).normal(size=(3, 3, 6, 8)).astype(np.float32)
    for number in range(9):
        write_pfm(scene / f"gt_disp_lowres_Cam{number:03d}.pfm", every[divmod(number, 3)])
        save_image(scene / f"objectids_lowres_Cam{number:03d}.png", np.full((6, 8), number, "u1"))
    write_pfm(scene / "gt_disp_lowres.pfm", every[1, 1])
    truth = known(load_light_field(scene, flip_v=True).truth)
    np.testing.assert_array_equal(np.asarray(truth.view_disparity), every[::-1])
    np.testing.assert_array_equal(np.asarray(known(truth.view_ids)[:, :, 2, 3])[:, 0], [6, 3, 0])
    np.testing.assert_array_equal(np.asarray(truth.object_ids), 4)
    (scene / "gt_disp_lowres.pfm").unlink()
    small = known(load_light_field(scene, scale=0.5).truth)
    expected = every[1, 1].reshape(3, 2, 4, 2).mean((1, 3)) / 2
    np.testing.assert_allclose(np.asarray(small.disparity), expected, atol=1e-6)
    np.testing.assert_allclose(np.asarray(known(small.view_disparity)[1, 1]), expected, atol=1e-6)
    write_pfm(scene / "gt_disp_lowres_Cam007.pfm", every[0, 0, :5])
    with pytest.raises(ValueError, match=r"gt_disp_lowres_Cam007\.pfm has the size \(5, 8\)"):
        load_light_field(scene)


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
    np.testing.assert_array_equal(
        np.asarray(loaded.horizontal_arm), views[middle].astype(np.float32) / 255
    )
    np.testing.assert_array_equal(
        np.asarray(loaded.vertical_arm), views[:, middle].astype(np.float32) / 255
    )


def test_nan_ground_truth(scene):
    values = np.zeros((6, 8), np.float32)
    values[2, 3] = np.nan
    write_pfm(scene / "gt_disp_lowres.pfm", values)
    with pytest.raises(ValueError, match=r"gt_disp_lowres\.pfm holds 1 values.*at \(2, 3\)"):
        load_light_field(scene)


def test_ground_truth_of_another_size(scene):
    write_pfm(scene / "gt_disp_lowres.pfm", np.zeros((5, 8), np.float32))
    with pytest.raises(ValueError, match=r"5x8 px .* expected 6x8, as .*input_Cam004\.png"):
        load_light_field(scene)


def test_truncated_ground_truth(scene):
    cut(scene / "gt_disp_lowres.pfm")
    with pytest.raises(ValueError, match=r"gt_disp_lowres\.pfm is truncated"):
        load_light_field(scene)


def test_ids_of_another_size(scene):
    save_image(scene / "objectids_lowres.png", np.zeros((6, 7), np.uint8))
    with pytest.raises(ValueError, match=r"objectids_lowres\.png has the shape \(6, 7\)"):
        load_light_field(scene)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("focal_length_mm = 100.0", "focal_length_mm = long", "focal_length_mm = 'long'"),
        ("baseline_mm = 25.0", "baseline_mm = -1", "must give positive"),
        ("num_cams_x = 3", "num_cams_x = 2.5", "promises 3 x 2.5 cameras"),
        ("num_cams_x = 3", "num_cams_x = 2", "lies outside the grid of 3x2 views"),
        ("_x_px = 8", "_x_px = 9", "6x8 px .* expected 6x9, as .*parameters.cfg"),
        ("disp_min = -1.5", "disp_min = 1.5", "disp_min = 1.5 and disp_max = 1.25"),
        ("[meta]", "meta", "cannot be read as a configuration"),
    ],
)
def test_settings_that_contradict(scene, old, new, text):
    file = scene / "parameters.cfg"
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))
    if new == "meta":
        file.write_text("meta\n" + file.read_text())
    with pytest.raises(ValueError, match=text) as caught:
        load_light_field(scene)
    assert str(scene) in str(caught.value)


def test_two_images_of_one_view(scene):
    save_image(scene / "input_Cam003.bmp", random_views()[0, 0])
    with pytest.raises(ValueError, match=r"input_Cam003\.png and .*input_Cam003\.bmp are both"):
        load_light_field(scene)


def test_settings_may_be_partial(scene):
    (scene / "parameters.cfg").write_text("[meta]\nscene = toy\n")
    loaded = load_light_field(scene)
    assert loaded.camera is None
    assert loaded.disparity_range is None
