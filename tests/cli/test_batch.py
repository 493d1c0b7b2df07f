import csv
import json

import numpy as np
import pytest
from datasets.layouts import write_hci
from scipy import ndimage

from mvedge_jax.cli import _batch, _main
from mvedge_jax.cli._paths import scenes_and_out
from mvedge_jax.datasets import read_pfm


def _plane(folder, disparity):
    """A textured plane, 3x3 views of 32x40 px, in the HCI layout."""
    rng = np.random.default_rng(0)
    texture = ndimage.gaussian_filter(rng.uniform(size=(52, 60, 3)), (0.9, 0.9, 0)) * 2 - 0.5
    y, x = np.mgrid[0:32, 0:40].astype(float) + 10
    views = np.zeros((3, 3, 32, 40, 3))
    for v, u in np.ndindex(3, 3):
        for c in range(3):
            place = [y - (1 - v) * disparity, x - (1 - u) * disparity]
            views[v, u, ..., c] = ndimage.map_coordinates(texture[..., c], place, order=3)
    truth = np.full((32, 40), disparity, np.float32)
    views = np.round(255 * np.clip(views, 0, 1)).astype(np.uint8)
    return write_hci(folder, views, disparity=truth)


def _summary(out):
    with (out / "summary.csv").open() as file:
        return {row["name"]: row for row in csv.DictReader(file)}


def test_a_batch_goes_on_after_a_failure_and_from_where_it_was(tmp_path, capsys, monkeypatch):
    near, far = _plane(tmp_path / "near", 0.4), _plane(tmp_path / "far", -0.2)
    corrupt = _plane(tmp_path / "corrupt", 0.0)
    (corrupt / "input_Cam004.png").write_bytes(b"not a picture")
    compilations = []
    compiled = _batch.compiled

    def counted(function, *arguments):
        compilations.append(arguments)
        return compiled(function, *arguments)

    monkeypatch.setattr(_batch, "compiled", counted)
    out = tmp_path / "out"
    words = [*map(str, (near, corrupt, far)), str(out), "--range", "-0.5", "1"]
    assert _main.main(["batch", *words]) == 1
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
    said = capsys.readouterr()
    assert "2 of 3 light fields done" in said.out
    assert "corrupt failed" in said.err

    assert _main.main(["batch", *words]) == 1
    assert len(compilations) == 1
    assert [row["state"] for row in _summary(out).values()] == [
        "there already",
        "failed",
        "there already",
    ]


def test_names_are_told_apart(tmp_path):
    for name in ("a/x", "b/x", "b/y"):
        (tmp_path / name).mkdir(parents=True)
    assert _batch._names([tmp_path / "a/x", tmp_path / "b/y"]) == ["x", "y"]
    assert _batch._names([tmp_path / "a/x", tmp_path / "b/x"]) == ["a_x", "b_x"]
    with pytest.raises(ValueError, match="is given twice"):
        _batch._names([tmp_path / "a/x", tmp_path / "b/../a/x"])


def test_paths_are_scenes_and_a_folder(tmp_path):
    assert scenes_and_out([tmp_path, tmp_path / "out"]) == ([tmp_path], tmp_path / "out")
    with pytest.raises(ValueError, match="at least one scene and OUT, got 1"):
        scenes_and_out([tmp_path])
    with pytest.raises(FileNotFoundError, match="there is no such file"):
        scenes_and_out([tmp_path / "missing", tmp_path])
