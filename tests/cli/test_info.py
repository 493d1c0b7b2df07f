import re

import numpy as np
import pytest
from datasets.layouts import random_views, save_image, write_grid, write_hci, write_stanford
from datasets.test_convention import cards_of

from mvedge_jax.cli._info import info


@pytest.fixture
def told(capsys):
    """Runs `info`: its lines by what they tell, and what it warns of, in one line."""

    def run(folder, **options):
        info(folder, **options)
        said = capsys.readouterr()
        lines = [line for line in said.out.splitlines() if "  " in line]
        found = dict(re.split(r"\s{2,}", line, maxsplit=1) for line in lines)
        return found, " ".join(said.err.split())

    return run


@pytest.fixture(scope="module")
def cards():
    """Textured cards before a textured wall, as bytes."""
    return np.round(255 * cards_of(1.5, -1.0, (5, 5, 90, 100))).astype(np.uint8)


def test_everything_that_is_known_is_said(tmp_path, told):
    truth = np.linspace(-1, 1, 48, dtype=np.float32).reshape(6, 8)
    folder = write_hci(tmp_path / "toy", random_views(), disparity=truth)
    save_image(folder / "objectids_lowres.png", np.arange(48, dtype=np.uint8).reshape(6, 8) // 16)
    lines, _ = told(folder, quick=True)
    assert lines["light field"] == "toy (HCI 4D benchmark)"
    assert lines["views"] == "3x3 of 8x6 px (width x height), all there"
    assert lines["memory"] == "0 MB as float32"
    assert lines["disparity range"] == "-1.500 .. 1.250 px per view step"
    assert lines["ground truth"] == "disparity -1.000 .. 1.000, 3 object ids"
    assert "focal length 22.9 px, baseline 25 mm, disparity 0 at 4.25 m" in lines["camera"]
    assert lines["brightness"] == "as it is"
    assert lines["gain of the views"].endswith("of the center view's")
    assert lines["noise"].endswith("of 255 at most")
    assert "convention" not in lines
    assert "not checked" in told(folder)[0]["convention"]  # too small


def test_missing_views_are_listed(tmp_path, told):
    folder = write_grid(tmp_path / "toy", random_views())
    (folder / "lf_01_03.png").unlink()
    assert "1 of 9 missing: (v, u) = (0, 2)" in told(folder, quick=True)[0]["views"]
    for name in ("lf_01_01.png", "lf_03_01.png", "lf_03_03.png"):
        (folder / name).unlink()
    assert "the 5 of the crosshair only" in told(folder, quick=True)[0]["views"]


def test_positions_are_told(tmp_path, told):
    rig = write_stanford(tmp_path / "uneven", random_views(), jitter=8.0)
    assert told(rig, quick=True)[0]["positions"].startswith("not regular: 3x3 views")
    folder = write_stanford(tmp_path / "rig", random_views(), pitch=(40.0, 60.0))
    assert told(folder, quick=True)[0]["positions"] == (
        "not regular: 3x3 views, columns 1 .. 1 apart, rows 1.5 .. 1.5 apart (view steps)"
    )
    file = tmp_path / "positions.txt"
    file.write_text("1 0 -1 0\n1 1 0 0\n1 2 1.25 0\n")
    assert told(folder, positions=file, quick=True)[0]["positions"] == (
        "not regular: 1x3 views, columns 1 .. 1.25 apart (view steps)"
    )
    regular = write_grid(tmp_path / "toy", random_views())
    assert told(regular, quick=True)[0]["positions"] == "regular grid"


def test_the_right_way_round(tmp_path, told, cards):
    lines, said = told(write_grid(tmp_path / "cards", cards))
    assert lines["convention"] == "holds: near covers far along both axes"
    low, high = (float(word) for word in re.findall(r"-?\d+\.\d+", lines["range, estimated"]))
    assert (low, high) == pytest.approx((-1.0, 1.5), abs=0.2)
    assert "warning" not in said


def test_a_reversed_axis_is_warned_of(tmp_path, told, cards):
    folder = write_grid(tmp_path / "cards", cards[:, ::-1])
    lines, said = told(folder)
    assert lines["convention"] == "columns (u) REVERSED, rows (v) right"
    assert "with --flip-u." in said
    lines, said = told(folder, flip_u=True, flip_v=True)
    assert lines["convention"] == "columns (u) right, rows (v) REVERSED"
    assert "without --flip-v." in said


def test_exchanged_axes_are_warned_of(tmp_path, told, cards):
    folder = write_grid(tmp_path / "cards", cards[:, ::-1].swapaxes(0, 1))
    lines, said = told(folder)
    assert lines["convention"] == (
        "rows and columns EXCHANGED; after that, columns (u) REVERSED, rows (v) right"
    )
    assert "moves up and down. Load them with --swap-axes and with --flip-u." in said
    assert told(folder, swap_axes=True, flip_u=True)[0]["convention"].startswith("holds")
    _, said = told(folder, flip_v=True)  # reverses what will be the columns
    assert "Load them with --swap-axes and with --flip-u and without --flip-v." in said


def test_command_line(tmp_path, mvedge):
    folder = write_grid(tmp_path / "toy", random_views((5, 5, 6, 8, 3)))
    assert "3x3 of 8x6 px" in mvedge("info", folder, "--views", 3, "--quick").out


def test_a_view_that_shows_nothing_is_named(tmp_path, told, cards):
    views = cards.copy()
    views[2, 4] = 0
    lines, said = told(write_grid(tmp_path / "toy", views, pattern="v_{}_{}.png"), quick=True)
    assert "1 of 25 missing: (v, u) = (2, 4)" in lines["views"]
    assert "v_3_5.png is black." in said
