"""`mvedge superpixels`: everything is written, and the pick is recolored in all views."""

import json

import numpy as np
import pytest
from cli.scenes import write_plane

from mvedge_jax.datasets import load_light_field


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_plane(tmp_path_factory.mktemp("superpixels") / "plane", disparity=0.0)


def test_superpixels_writes_labels_tables_and_pictures(scene, tmp_path, mvedge):
    out = tmp_path / "out"
    mvedge("superpixels", scene, out, "--count", 20, "--pick", 20, 16)
    labels = np.load(out / "labels.npy")
    assert labels.shape == (3, 3, 32, 40)
    assert labels.dtype == np.int32
    report = json.loads((out / "report.json").read_text())
    assert 12 <= report["count"] <= 30
    assert report["scores"]["unlabeled"] == 0
    rows = (out / "superpixels.csv").read_text().splitlines()
    assert len(rows) == report["count"] + 1
    assert rows[0].startswith("label,x,y,disparity")
    for name in ("neighbors.csv", "superpixels.png", "colors.png", "superpixels.gif"):
        assert (out / name).stat().st_size > 0
    before, after = (np.asarray(load_light_field(path).views) for path in (scene, out / "edited"))
    changed = np.abs(after - before).max(-1) > 0.01
    picked = labels == report["picked"]
    assert picked[1, 1, 16, 20]
    assert changed[picked].mean() > 0.9
    assert changed[~picked].mean() < 0.01
