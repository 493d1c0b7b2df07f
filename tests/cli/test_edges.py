import csv
import json

import cv2
import numpy as np
import pytest
from cli.scenes import textured_plane
from datasets.layouts import write_hci

from mvedge_jax.cli import _edges, _main


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_hci(tmp_path_factory.mktemp("edges") / "plane", textured_plane())


def test_edges_writes_everything_and_is_right(scene, tmp_path, capsys):
    out = tmp_path / "out"
    assert _main.main(["edges", str(scene), str(out), "--range", "-0.5", "1"]) == 0
    points = np.load(out / "points.npz")
    counts = json.loads((out / "report.json").read_text())["counts"]
    assert len(points["xy"]) == counts["valid"] > 50
    assert np.median(np.abs(points["disparity"] - 0.4)) < 0.01
    assert points["visible"].shape == (counts["valid"], 6)
    with (out / "points.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == counts["valid"]
    np.testing.assert_allclose(
        [float(row["disparity"]) for row in rows], points["disparity"], atol=1e-5
    )
    np.testing.assert_allclose([float(row["x"]) for row in rows], points["xy"][:, 0], atol=1e-3)
    for name in ("points.png", "epi_horizontal.png", "epi_vertical.png"):
        picture = cv2.imread(str(out / name))
        assert picture is not None, name
        assert picture.std() > 1, name
    text = capsys.readouterr()
    assert "written to" in text.out
    assert "choosing sizes" in text.err


@pytest.mark.slow
def test_the_edges_of_the_thesis_are_drawn_from_a_seed(scene, tmp_path):
    found = []
    for name, seed in (("one", 0), ("again", 0), ("other", 1)):
        words = ["--range", "-0.5", "1", "--preset", "thesis", "--seed", str(seed)]
        # Three views never show a line in four in a row.
        words += ["--set", "edges.lines.alignment=none"]
        assert _main.main(["edges", str(scene), str(tmp_path / name), *words]) == 0
        report = json.loads((tmp_path / name / "report.json").read_text())
        assert (report["preset"], report["seed"]) == ("thesis", seed)
        assert report["numbers"]["edges.lines.decay"] == 0.88
        found.append(np.load(tmp_path / name / "points.npz")["disparity"])
    one, again, other = found
    np.testing.assert_array_equal(one, again)
    assert one.shape != other.shape or np.any(one != other)


def test_the_epi_with_the_widest_spread_is_drawn():
    # Row 0 is far from the rest, but all of it at one depth; row 2 has two depths.
    index = np.array([0, 0, 0, 1, 1, 2, 2, 2])
    disparity = np.array([-5.0, -5.0, -5.0, 0.1, 0.2, 1.0, -1.0, 1.0], np.float32)
    assert _edges._most_varied(index, disparity) == 2
