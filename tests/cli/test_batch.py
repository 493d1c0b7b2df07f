import csv
import json
import shutil

import numpy as np
import pytest
from cli.scenes import RANGE, write_plane

from mvedge_jax.cli import _batch, _batch_scene
from mvedge_jax.cli._source import scene_of
from mvedge_jax.datasets import read_pfm


def _summary(out):
    with (out / "summary.csv").open() as file:
        return {row["name"]: row for row in csv.DictReader(file)}


@pytest.fixture
def compilations(monkeypatch):
    """What was compiled: the arguments of every call."""
    calls, compiled = [], _batch_scene.compiled

    def counted(function, *arguments, **options):
        calls.append(arguments)
        return compiled(function, *arguments, **options)

    monkeypatch.setattr(_batch_scene, "compiled", counted)
    return calls


def test_a_batch_goes_on_after_a_failure_and_from_where_it_was(tmp_path, mvedge, compilations):
    near, far = write_plane(tmp_path / "near"), write_plane(tmp_path / "far", disparity=-0.2)
    corrupt = write_plane(tmp_path / "corrupt")
    (corrupt / "input_Cam004.png").write_bytes(b"not a picture")
    out = tmp_path / "out"
    words = ["batch", near, corrupt, far, out, *RANGE]
    said = mvedge(*words, code=1)
    assert len(compilations) == 1
    assert np.median(np.abs(read_pfm(out / "near" / "disparity.pfm") - 0.4)) < 0.01
    assert np.median(np.abs(read_pfm(out / "far" / "disparity.pfm") + 0.2)) < 0.01
    rows = _summary(out)
    assert [row["state"] for row in rows.values()] == ["done", "failed", "done"]
    assert float(rows["far"]["mse"]) < 0.1
    assert "input_Cam004.png" in rows["corrupt"]["reason"]
    assert not (out / "corrupt").exists()
    assert json.loads((out / "summary.json").read_text())["near"]["converged"] is True
    assert rows["near"]["warnings"] == ""
    assert json.loads((out / "near" / "report.json").read_text())["warnings"] == []
    assert scene_of(out / "near", advice="") == (near, {"views": None, "scale": 1.0})
    assert "2 of 3 light fields done" in said.out
    assert "corrupt failed" in said.err

    mvedge(*words, code=1)
    assert len(compilations) == 1
    there = "there already"
    assert [row["state"] for row in _summary(out).values()] == [there, "failed", there]


@pytest.mark.slow
def test_frames_take_their_range_from_the_frame_before(tmp_path, mvedge, monkeypatch, compilations):
    measured, measure = [], _batch_scene.scene_range

    def counted(light_field):
        measured.append(light_field)
        return measure(light_field)

    monkeypatch.setattr(_batch_scene, "scene_range", counted)
    depths = [0.2, 0.25, 1.6, 1.5]
    frames = [write_plane(tmp_path / f"f{i}", disparity=d, seed=i) for i, d in enumerate(depths)]
    out = tmp_path / "out"
    mvedge("batch", *frames, out, "--video")
    # The first frame, and the one that leaves its range; so do the programs.
    assert (len(measured), len(compilations)) == (2, 2)
    for frame, depth in zip(frames, depths, strict=True):
        found = read_pfm(out / frame.name / "disparity.pfm")
        assert np.median(np.abs(found - depth)) < 0.02, frame.name


def test_frames_are_compared_with_the_frame_before(tmp_path, mvedge):
    # Center views are all the same; only depth changes.
    depths = [0.2, 0.25, 0.7]
    frames = [write_plane(tmp_path / f"f{i}", disparity=d) for i, d in enumerate(depths)]
    out = tmp_path / "out"
    words = ["batch", *frames, out, "--video", *RANGE]
    mvedge(*words)
    rows = list(_summary(out).values())
    assert rows[0]["unchanged"] == rows[0]["change"] == ""
    assert [float(row["unchanged"]) for row in rows[1:]] == [1, 1]
    assert [float(row["change"]) for row in rows[1:]] == pytest.approx([0.05, 0.45], abs=0.01)
    # A later run knows the frame before from its files.
    shutil.rmtree(out / "f1")
    mvedge(*words)
    again = _summary(out)
    assert [row["state"] for row in again.values()] == ["there already", "done", "there already"]
    assert again["f1"]["change"] == rows[1]["change"]


def test_names_are_told_apart(tmp_path):
    assert _batch._names([tmp_path / "a/x", tmp_path / "b/y"]) == ["x", "y"]
    assert _batch._names([tmp_path / "a/x", tmp_path / "b/x"]) == ["a_x", "b_x"]
