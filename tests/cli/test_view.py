import json

import h5py
import numpy as np
import pytest
from cli.scenes import write_result, write_stereo_result, write_wall
from posed.walls import MATRIX
from viewer.scenes import disparity, square_field

from mvedge_jax import viewer
from mvedge_jax.cli import _view
from mvedge_jax.datasets import write_hci, write_pfm


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("view") / "square"
    folder.mkdir()
    write_hci(square_field(), folder)
    return folder


@pytest.fixture
def result(scene, tmp_path):
    return write_result(tmp_path / "result", scene, disparity())


def _data(path):
    return json.loads(path.read_text("utf-8").split('id="data">')[1].split("</script>")[0])


def test_a_scene_becomes_one_file(scene, tmp_path, mvedge):
    out = tmp_path / "page.html"
    assert f"written to {out}" in mvedge("view", scene, "--html", out).out
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
    data = _data(out)
    assert data["shape"] == [5, 5, 48, 64]
    assert data["results"] == []
    mvedge("view", scene, "--html", out, "--overwrite", "--views", 3)
    assert _data(out)["shape"] == [3, 3, 48, 64]


def test_a_result_finds_its_scene_and_another_is_compared(result, scene, tmp_path, mvedge):
    other, labels, out = (tmp_path / name for name in ("other.pfm", "superpixels", "page.html"))
    write_pfm(other, disparity() + 0.1)
    labels.mkdir()
    np.save(labels / "labels.npy", np.ones((5, 5, 48, 64), np.int32))
    mvedge("view", result, "--other", other, "--superpixels", labels, "--html", out)
    data = _data(out)
    assert [r["name"] for r in data["results"]] == ["result", "other"]
    assert data["results"][0]["scores"][0][1] == 0
    assert data["results"][1]["scores"][0][1] == pytest.approx(1, abs=1e-3)
    assert data["results"][0]["labels"] is not None
    twin = ("--other", result / "disparity.pfm", "--scene", scene)
    mvedge("view", result, *twin, "--html", tmp_path / "twins.html")
    source = {"path": "/gone", "views": None, "scale": 1.0, "flip_u": False, "flip_v": False}
    (result / "report.json").write_text(json.dumps({"source": source}))
    assert "/gone, the light field of" in mvedge("view", result, code=2).err


def test_what_other_views_show_comes_from_every_view(result, tmp_path, mvedge):
    folder, out = tmp_path / "views", tmp_path / "page.html"
    folder.mkdir()
    source = np.zeros((5, 5, 48, 64), np.int8)
    source[2, 4, 20, 10:14] = 1
    with h5py.File(folder / "views.h5", "w") as file:
        file["disparity"] = np.zeros((5, 5, 48, 64), np.float32)
        file["error"] = np.full((5, 5, 48, 64), 0.1, np.float32)
        file["source"] = source
    mvedge("view", result, "--hidden", folder, "--html", out)
    hidden = _data(out)["results"][0]["hidden"]
    assert hidden["x"]["shape"] == [4]
    assert (hidden["x"]["low"], hidden["x"]["high"]) == pytest.approx((10, 13))


def test_it_is_served_until_it_is_stopped(scene, monkeypatch, mvedge):
    opened = []
    monkeypatch.setattr(_view.webbrowser, "open", opened.append)

    def stop(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(viewer.Server, "serve_forever", stop)
    said = mvedge("view", scene, "--port", 0, code=130)
    assert "until Ctrl-C" in said.out
    assert len(opened) == 1
    assert opened[0].startswith("http://127.0.0.1:")
    mvedge("view", scene, "--port", 0, "--no-browser", code=130)
    assert len(opened) == 1


def test_a_photograph_is_shown_with_its_depth(tmp_path, mvedge):
    out, (model, depths) = tmp_path / "page.html", write_wall(tmp_path / "model")
    stereo = write_stereo_result(tmp_path / "stereo", model, depths, ("1", "3.png"))
    words = ("--html", out, "--overwrite")
    for choice, name in (([], "1.png"), (["--reference", 3], "3.png")):
        mvedge("view", stereo, *words, *choice)
        data = _data(out)
        assert data["shape"] == [1, 1, *depths[0].shape]
        assert (data["name"], data["unit"]) == (name, "units of the model")
        focal, depth = MATRIX[0, 0], depths[int(name[0])]
        assert data["camera"] == pytest.approx([focal, 0.2, 0])
        ends = focal * 0.2 / depth.max(), focal * 0.2 / depth.min()
        assert data["range"] == pytest.approx(ends, rel=1e-4)
        assert data["results"][0]["error"] is not None
    twin = stereo.rename(tmp_path / "twin")
    for choice, message in (
        (["--other", twin], "different names"),
        (["--reference", 0], "has no depth of '0'; it has that of 1.png, 3.png."),
        (["--reference", "none"], "no photograph is called 'none'"),
        (["--scene", twin], "--scene is for light fields"),
        (["--other", tmp_path], "--other must be what `mvedge stereo` wrote"),
    ):
        assert message in mvedge("view", twin, *words, *choice, code=2).err
