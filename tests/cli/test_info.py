import os
import re

import cv2
import numpy as np
import pytest
from datasets.layouts import random_views, save_image, write_grid, write_hci, write_stanford

from mvedge_jax.cli import _main
from mvedge_jax.cli._info import info


def _lines(text):
    return dict(re.split(r"\s{2,}", line, maxsplit=1) for line in text.splitlines() if "  " in line)


def _cards(rows=5, size=64):
    """A textured card of disparity 1.5 before a textured wall of -1, as bytes."""
    draw = np.random.default_rng(0)
    wall, card = (
        cv2.GaussianBlur(draw.uniform(0, 255, (3 * size, 3 * size, 3)), (0, 0), 1.5) for _ in "ab"
    )
    wall, card = ((t - t.min()) / (t.max() - t.min()) * 255 for t in (wall, card))
    y, x = np.mgrid[:size, :size].astype(np.float32)
    views = np.zeros((rows, rows, size, size, 3), np.uint8)
    for v, u in np.ndindex(rows, rows):
        du, dv = rows // 2 - u, rows // 2 - v
        back, front = (
            cv2.remap(t, x - d * du + size, y - d * dv + size, cv2.INTER_CUBIC)
            for t, d in ((wall, -1.0), (card, 1.5))
        )
        inside = (abs(x - 1.5 * du - size / 2) < size / 5) & (
            abs(y - 1.5 * dv - size / 2) < size / 5
        )
        views[v, u] = np.where(inside[..., None], front, back).clip(0, 255)
    return views


def test_everything_that_is_known_is_said(tmp_path, capsys):
    truth = np.linspace(-1, 1, 48, dtype=np.float32).reshape(6, 8)
    folder = write_hci(tmp_path / "toy", random_views(), disparity=truth)
    save_image(folder / "objectids_lowres.png", np.arange(48, dtype=np.uint8).reshape(6, 8) // 16)
    info(folder, quick=True)
    lines = _lines(capsys.readouterr().out)
    assert lines["light field"] == "toy (HCI 4D benchmark)"
    assert lines["views"] == "3x3 of 8x6 px (width x height), all there"
    assert lines["memory"] == "0 MB as float32"
    assert lines["disparity range"] == "-1.500 .. 1.250 px per view step"
    assert lines["ground truth"] == "disparity -1.000 .. 1.000, 3 object ids"
    assert "focal length 22.9 px, baseline 25 mm, disparity 0 at 4.25 m" in lines["camera"]
    assert lines["brightness"] == "as it is"
    assert lines["gain of the views"].endswith("of the centre view's")
    assert lines["noise"].endswith("of 255 at most")
    assert "convention" not in lines


def test_missing_views_are_listed(tmp_path, capsys):
    folder = write_grid(tmp_path / "toy", random_views())
    (folder / "lf_01_03.png").unlink()
    info(folder, quick=True)
    assert "1 of 9 missing: (v, u) = (0, 2)" in _lines(capsys.readouterr().out)["views"]
    for name in ("lf_01_01.png", "lf_03_01.png", "lf_03_03.png"):
        (folder / name).unlink()
    info(folder, quick=True)
    assert "the 5 of the crosshair only" in _lines(capsys.readouterr().out)["views"]


def test_uneven_cameras_are_reported(tmp_path, capsys):
    info(write_stanford(tmp_path / "rig", random_views(), jitter=8.0), quick=True)
    assert _lines(capsys.readouterr().out)["positions"].startswith("not regular: 3x3 views")


def test_positions_are_told(tmp_path, capsys):
    folder = write_stanford(tmp_path / "rig", random_views(), pitch=(40.0, 60.0))
    info(folder, quick=True)
    told = _lines(capsys.readouterr().out)["positions"]
    assert (
        told == "not regular: 3x3 views, columns 1 .. 1 apart, rows 1.5 .. 1.5 apart (view steps)"
    )
    file = tmp_path / "positions.txt"
    file.write_text("1 0 -1 0\n1 1 0 0\n1 2 1.25 0\n")
    info(folder, positions=file, quick=True)
    told = _lines(capsys.readouterr().out)["positions"]
    assert told == "not regular: 1x3 views, columns 1 .. 1.25 apart (view steps)"
    info(write_grid(tmp_path / "toy", random_views()), quick=True)
    assert _lines(capsys.readouterr().out)["positions"] == "regular grid"


def test_the_right_way_round(tmp_path, capsys):
    info(write_grid(tmp_path / "cards", _cards()))
    captured = capsys.readouterr()
    lines = _lines(captured.out)
    assert lines["convention"] == "holds: near covers far along both axes"
    low, high = (float(word) for word in re.findall(r"-?\d+\.\d+", lines["range, estimated"]))
    assert (low, high) == pytest.approx((-1.0, 1.5), abs=0.2)
    assert "warning" not in captured.err


def test_a_reversed_axis_is_warned_of(tmp_path, capsys):
    folder = write_grid(tmp_path / "cards", _cards()[:, ::-1])
    info(folder)
    captured = capsys.readouterr()
    assert _lines(captured.out)["convention"] == "columns (u) REVERSED, rows (v) right"
    assert "with --flip-u." in " ".join(captured.err.split())
    info(folder, flip_u=True, flip_v=True)
    captured = capsys.readouterr()
    assert _lines(captured.out)["convention"] == "columns (u) right, rows (v) REVERSED"
    assert "without --flip-v." in " ".join(captured.err.split())


def test_exchanged_axes_are_warned_of(tmp_path, capsys):
    views = _cards()[:, ::-1].swapaxes(0, 1)
    folder = write_grid(tmp_path / "cards", views)
    info(folder)
    captured = capsys.readouterr()
    assert _lines(captured.out)["convention"] == (
        "rows and columns EXCHANGED; after that, columns (u) REVERSED, rows (v) right"
    )
    assert "moves up and down. Load them with --swap-axes and with --flip-u." in captured.err
    info(folder, swap_axes=True, flip_u=True)
    assert _lines(capsys.readouterr().out)["convention"].startswith("holds")
    info(folder, flip_v=True)  # reverses what will be the columns
    said = capsys.readouterr().err
    assert "Load them with --swap-axes and with --flip-u and without --flip-v." in said


def test_what_is_too_small_is_not_checked(tmp_path, capsys):
    info(write_grid(tmp_path / "toy", random_views()))
    assert "not checked" in _lines(capsys.readouterr().out)["convention"]


def test_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(os.environ, "MVEDGE_CACHE", "off")
    folder = write_grid(tmp_path / "toy", random_views((5, 5, 6, 8, 3)))
    assert _main.main(["info", str(folder), "--views", "3", "--quick"]) == 0
    assert "3x3 of 8x6 px" in capsys.readouterr().out
    assert _main.main(["info", str(tmp_path / "nowhere")]) == 2
    error = capsys.readouterr().err
    assert "nowhere is not there" in error
    assert "Traceback" not in error


def test_a_view_that_shows_nothing_is_named(tmp_path, capsys):
    views = _cards()
    views[2, 4] = 0
    info(write_grid(tmp_path / "toy", views, pattern="v_{}_{}.png"), quick=True)
    captured = capsys.readouterr()
    assert "1 of 25 missing: (v, u) = (2, 4)" in _lines(captured.out)["views"]
    assert "v_3_5.png is black." in captured.err
