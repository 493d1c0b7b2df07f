"""`mvedge superpixels`: everything is written, and the pick is recoloured in all views."""

import json

import numpy as np
import pytest
from datasets.layouts import write_hci
from scipy import ndimage

from mvedge_jax.cli import _main
from mvedge_jax.datasets import load_light_field


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A textured plane at disparity 0, 3x3 views of 32x40 px, in the HCI layout."""
    rng = np.random.default_rng(0)
    texture = ndimage.gaussian_filter(rng.uniform(size=(32, 40, 3)), (0.9, 0.9, 0)) * 0.5 + 0.2
    views = np.broadcast_to(np.round(255 * texture).astype(np.uint8), (3, 3, 32, 40, 3))
    truth = np.zeros((32, 40), np.float32)
    return write_hci(tmp_path_factory.mktemp("superpixels") / "plane", views, disparity=truth)


def test_superpixels_writes_labels_tables_and_pictures(scene, tmp_path):
    out = tmp_path / "out"
    words = ["superpixels", str(scene), str(out), "--count", "20", "--pick", "20", "16"]
    assert _main.main(words) == 0
    labels = np.load(out / "labels.npy")
    assert labels.shape == (3, 3, 32, 40)
    assert labels.dtype == np.int32
    report = json.loads((out / "report.json").read_text())
    assert 12 <= report["count"] <= 30
    assert report["scores"]["unlabelled"] == 0
    rows = (out / "superpixels.csv").read_text().splitlines()
    assert len(rows) == report["count"] + 1
    assert rows[0].startswith("label,x,y,disparity")
    for name in ("neighbours.csv", "superpixels.png", "colours.png", "superpixels.gif"):
        assert (out / name).stat().st_size > 0
    before, after = (np.asarray(load_light_field(path).views) for path in (scene, out / "edited"))
    changed = np.abs(after - before).max(-1) > 0.01
    picked = labels == report["picked"]
    assert picked[1, 1, 16, 20]
    assert changed[picked].mean() > 0.9
    assert changed[~picked].mean() < 0.01
