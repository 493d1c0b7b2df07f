"""Positions of cameras: from names, files and settings to view steps."""

import jax
import numpy as np
import pytest
from datasets.layouts import (
    known,
    random_views,
    write_grid,
    write_hci as write_scene,
    write_stanford,
)
from numpy.testing import assert_allclose, assert_array_equal

from mvedge_jax import LightField
from mvedge_jax.datasets import load_light_field, synthetic, write_hci

ROW = random_views((1, 9, 6, 8, 3))


def _grid(columns, rows):
    return np.stack(np.meshgrid(columns, rows), axis=-1).astype(float)


def _found(folder, **options):
    return known(load_light_field(folder, **options).positions)


def test_oblong_cells_come_from_the_names(tmp_path):
    folder = write_stanford(tmp_path / "rig", random_views(), pitch=(40.0, 60.0))
    expected = _grid([-1, 0, 1], [-1.5, 0, 1.5])
    assert_allclose(_found(folder), expected, atol=1e-5)
    # Exchanged, the steps are those of the other axis.
    turned = _grid([-1, 0, 1], [-2 / 3, 0, 2 / 3])
    assert_allclose(_found(folder, swap_axes=True), turned, atol=1e-5)
    assert_allclose(_found(folder, flip_u=True, flip_v=True), expected, atol=1e-5)
    # A missing view is where its row and column are.
    next(folder.glob("out_00_02_*")).unlink()
    field = load_light_field(folder)
    assert not bool(field.available[0, 2])
    assert_allclose(known(field.positions)[0, 2], [1, -1.5], atol=1e-5)


@pytest.mark.parametrize(("jitter", "regular"), [(0.0, True), (0.5, True), (4.0, False)])
def test_what_is_regular_to_two_per_cent_is_regular(tmp_path, jitter, regular):
    field = load_light_field(write_stanford(tmp_path / "rig", random_views(), jitter=jitter))
    assert (field.positions is None) == regular


def test_uneven_columns_gaps_and_flips(tmp_path):
    places = _grid([0, 40, 120, 160, 240], [0])
    folder = write_stanford(tmp_path / "row", ROW[:, :5], places=places)
    assert_allclose(_found(folder)[0, :, 0], [-2, -4 / 3, 0, 2 / 3, 2])
    assert_allclose(_found(folder, flip_u=True)[0, :, 0], [-2, -2 / 3, 0, 4 / 3, 2])
    folder = write_stanford(tmp_path / "even", ROW)
    for column in (1, 3, 5, 7):
        next(folder.glob(f"out_00_{column:02d}_*")).unlink()
    field = load_light_field(folder)
    assert field.views.shape[:2] == (1, 5)
    assert field.positions is None
    folder = write_stanford(tmp_path / "gap", ROW[:, :6])
    next(folder.glob("out_00_01_*")).unlink()
    assert_allclose(_found(folder)[0, :, 0], [-3, -1, 0, 1, 2])


def test_cameras_of_no_grid_are_refused(tmp_path):
    for columns, match in (
        ([5, 5, 5], r"lf \(Stanford archive\) has .* same position"),
        ([0, 60, 50], r"lf \(Stanford archive\) do not fit: .*increase"),
    ):
        folder = tmp_path / str(columns) / "lf"
        write_stanford(folder, ROW[:, :3], places=_grid(columns, [0]))
        with pytest.raises(ValueError, match=match):
            load_light_field(folder)


def test_a_file_tells_positions(tmp_path):
    folder, file = write_grid(tmp_path / "row", ROW), tmp_path / "positions.txt"
    file.write_text("# v u x y\n0 0 -4 0\n0 2 -2.2 0\n0 4 0 0  # the center\n\n0 6 2 0\n0 8 4 0\n")
    field = load_light_field(folder, positions=file)
    assert_array_equal(field.views, load_light_field(folder).views[:, ::2])
    assert_allclose(known(field.positions)[0, :, 0], [-4, -2.2, 0, 2, 4], rtol=1e-6)
    file.write_text("".join(f"0 {u} {u - 4.01} 0\n" for u in range(9)))
    assert load_light_field(folder, positions=file).positions is None


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (None, r"positions.txt is not there; expected a text file"),
        ("0 0 -1", r"positions.txt says '0 0 -1' in line 1; expected four numbers"),
        ("0 0 -1 nan", r"positions.txt says '0 0 -1 nan' in line 1; expected four numbers"),
        ("\n0 9 1 0", r"names view \(v, u\) = \(0, 9\) in line 2; .* grid of 3x3 views of lf"),
        ("0.5 1 1 0", r"names view \(v, u\) = \(0.5, 1\) in line 1"),
        ("0 0 0 0\n0 0 0 0", r"names view \(v, u\) = \(0, 0\) twice"),
        ("# nothing", r"positions.txt names no view"),
        ("1 0 1 0\n1 1 0 0\n1 2 -1 0", r"lf \(.*\) do not fit: .*columns that incr"),
        ("0 0 -1 0\n0 1 0 0\n0 2 1.5 0", r"input_Cam001.png is in the middle; .*Cam004"),
    ],
)
def test_a_file_of_positions_is_checked(tmp_path, text, match):
    truth = np.ones((6, 8), np.float32)  # which is that of the center view
    folder = write_scene(tmp_path / "lf", random_views(), disparity=truth)
    file = tmp_path / "positions.txt"
    file.write_text("1 0 -1 0\n1 1 0 0\n1 2 1.5 0\n")
    field = load_light_field(folder, positions=file)
    assert field.truth is not None
    assert field.views.shape[:2] == (1, 3)
    if text is None:
        file.unlink()
    else:
        file.write_text(text)
    with pytest.raises(FileNotFoundError if text is None else ValueError, match=match):
        load_light_field(folder, positions=file)


def test_settings_keep_positions(tmp_path):
    places = _grid([-2, -0.7, 0, 1, 2.25], [-1.5, 0, 1.5])
    views = random_views((3, 5, 6, 8, 3)) / np.float32(255)
    write_hci(LightField(views, positions=places), tmp_path / "scene")
    assert_allclose(_found(tmp_path / "scene", views=3), places[:, 1:4], rtol=1e-6)
    settings = tmp_path / "scene" / "parameters.cfg"
    text = settings.read_text()
    for bad in ("two", "nan", "0 -2"):
        settings.write_text(text.replace("positions_x = -2", f"positions_x = {bad}"))
        with pytest.raises(ValueError, match=rf"says positions_x = '{bad} .* of the 3x5 views"):
            load_light_field(tmp_path / "scene", views=3)


def test_rendered_views_are_where_they_are_asked_for():
    scene, places = synthetic.scene("crossing"), _grid([-2, -1, 0, 1, 2], [0])

    def rendered(positions):
        options = {"shape": (1, 5, 12, 16), "samples": 1, "key": jax.random.key(0)}
        return synthetic.render(scene, positions=positions, **options)

    same, half = rendered(places), rendered(places / 2)
    assert_array_equal(same.views, rendered(None).views)
    ends, inner = (known(known(field.truth).view_disparity) for field in (half, same))
    assert_array_equal(ends[0, 4], inner[0, 3])
    with pytest.raises(ValueError, match=r"`positions` must have the shape \(1, 5, 2\), got"):
        rendered(places[:, :3])
