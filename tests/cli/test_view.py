import json

import h5py
import numpy as np
import pytest
from posed.walls import MATRIX, POSES, wall
from viewer.scenes import disparity, square_field

from mvedge_jax import viewer
from mvedge_jax.cli import _main, _view
from mvedge_jax.datasets import write_hci, write_pfm
from mvedge_jax.datasets.exchange import write_colmap
from mvedge_jax.posed import Photographs


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("view") / "square"
    folder.mkdir()
    write_hci(square_field(), folder)
    return folder


@pytest.fixture
def result(scene, tmp_path):
    folder = tmp_path / "result"
    folder.mkdir()
    write_pfm(folder / "disparity.pfm", disparity())
    source = {"path": str(scene), "views": None, "scale": 1.0, "flip_u": False, "flip_v": False}
    (folder / "report.json").write_text(json.dumps({"source": source}))
    return folder


def _data(path):
    return json.loads(path.read_text("utf-8").split('id="data">')[1].split("</script>")[0])


def test_a_scene_becomes_one_file(scene, tmp_path, capsys):
    out = tmp_path / "page.html"
    assert _main.main(["view", str(scene), "--html", str(out)]) == 0
    assert f"written to {out}" in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
    data = _data(out)
    assert data["shape"] == [5, 5, 48, 64]
    assert data["results"] == []
    assert _main.main(["view", str(scene), "--html", str(out)]) == 2
    assert "is there already" in capsys.readouterr().err
    small = ["view", str(scene), "--html", str(out), "--overwrite", "--views", "3"]
    assert _main.main(small) == 0
    assert _data(out)["shape"] == [3, 3, 48, 64]


def test_a_result_finds_its_scene_and_another_is_compared(result, scene, tmp_path):
    other = tmp_path / "other.pfm"
    write_pfm(other, disparity() + 0.1)
    labels = tmp_path / "superpixels"
    labels.mkdir()
    np.save(labels / "labels.npy", np.ones((5, 5, 48, 64), np.int32))
    out = tmp_path / "page.html"
    words = ["view", str(result), "--other", str(other), "--superpixels", str(labels)]
    assert _main.main([*words, "--html", str(out)]) == 0
    data = _data(out)
    assert [r["name"] for r in data["results"]] == ["result", "other"]
    assert data["results"][0]["scores"][0][1] == 0
    assert data["results"][1]["scores"][0][1] == pytest.approx(1, abs=1e-3)
    assert data["results"][0]["labels"] is not None
    twins = ["view", str(result), "--other", str(result / "disparity.pfm"), "--scene", str(scene)]
    assert _main.main([*twins, "--html", str(tmp_path / "twins.html")]) == 0


def test_what_other_views_show_comes_from_every_view(result, tmp_path, capsys):
    folder = tmp_path / "views"
    folder.mkdir()
    words = ["view", str(result), "--hidden", str(folder), "--html", str(tmp_path / "page.html")]
    assert _main.main(words) == 2
    assert "views.h5 does not exist; `mvedge views` writes it" in capsys.readouterr().err
    source = np.zeros((5, 5, 48, 64), np.int8)
    source[2, 4, 20, 10:14] = 1
    with h5py.File(folder / "views.h5", "w") as file:
        file["disparity"] = np.zeros((5, 5, 48, 64), np.float32)
        file["error"] = np.full((5, 5, 48, 64), 0.1, np.float32)
        file["source"] = source
    assert _main.main(words) == 0
    hidden = _data(tmp_path / "page.html")["results"][0]["hidden"]
    assert hidden["x"]["shape"] == [4]
    assert (hidden["x"]["low"], hidden["x"]["high"]) == pytest.approx((10, 13))


def test_what_is_missing_is_named(result, scene, tmp_path, capsys):
    (result / "report.json").write_text("{}")
    assert _main.main(["view", str(result)]) == 2
    assert "does not tell its light field; name it: --scene" in capsys.readouterr().err
    source = {"path": "/gone", "views": None, "scale": 1.0, "flip_u": False, "flip_v": False}
    (result / "report.json").write_text(json.dumps({"source": source}))
    assert _main.main(["view", str(result)]) == 2
    assert "/gone, the light field of" in capsys.readouterr().err
    assert _main.main(["view", str(scene), "--superpixels", str(tmp_path)]) == 2
    assert "--superpixels needs a RESULT" in capsys.readouterr().err
    assert _main.main(["view", str(scene), "--html", str(scene / "a.png"), "--overwrite"]) == 2
    assert "must name a file that ends in .html" in capsys.readouterr().err
    assert _main.main(["view", str(scene), "--html", str(tmp_path / "no" / "a.html")]) == 2
    assert "is no folder" in capsys.readouterr().err


def test_it_is_served_until_it_is_stopped(scene, monkeypatch, capsys):
    opened = []
    monkeypatch.setattr(_view.webbrowser, "open", opened.append)

    def stop(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(viewer.Server, "serve_forever", stop)
    assert _main.main(["view", str(scene), "--port", "0"]) == 130
    assert len(opened) == 1
    assert opened[0].startswith("http://127.0.0.1:")
    assert "until Ctrl-C" in capsys.readouterr().out
    assert _main.main(["view", str(scene), "--port", "0", "--no-browser"]) == 130
    assert len(opened) == 1


@pytest.fixture
def stereo(tmp_path):
    """What `mvedge stereo` writes of two of four photographs."""
    images, depths = wall(POSES)
    names = tuple(f"{i}.png" for i in range(4))
    posed = Photographs(images.astype(np.float32), POSES, MATRIX, names=names)
    write_colmap(tmp_path / "model", posed)
    folder = tmp_path / "stereo"
    folder.mkdir()
    for name in ("1", "3"):
        write_pfm(folder / f"{name}_depth.pfm", depths[int(name)])
        write_pfm(folder / f"{name}_error.pfm", 0.01 * depths[int(name)])
    rows = {name: {"baseline": 0.2} for name in ("1", "3.png")}
    report = {"model": str(tmp_path / "model"), "method": "dense", "scale": 1.0}
    report |= {"images": None, "intrinsics": None, "photographs": rows}
    (folder / "report.json").write_text(json.dumps(report))
    (folder / ".mvedge.json").write_text("{}")
    return folder


def test_a_photograph_is_shown_with_its_depth(stereo, tmp_path, capsys):
    out, size = tmp_path / "page.html", list(wall(POSES)[1][0].shape)
    words = ["view", str(stereo), "--html", str(out), "--overwrite"]
    for choice, name in (([], "1.png"), (["--reference", "3"], "3.png")):
        assert _main.main([*words, *choice]) == 0
        data = _data(out)
        assert data["shape"] == [1, 1, *size]
        assert (data["name"], data["unit"]) == (name, "units of the model")
        focal, depth = MATRIX[0, 0], wall(POSES)[1][int(name[0])]
        assert data["camera"] == pytest.approx([focal, 0.2, 0])
        ends = focal * 0.2 / depth.max(), focal * 0.2 / depth.min()
        assert data["range"] == pytest.approx(ends, rel=1e-4)
        assert data["results"][0]["error"] is not None
    twin = stereo.rename(tmp_path / "twin")
    assert _main.main(["view", str(twin), "--other", str(twin), *words[2:]]) == 2  # one name
    capsys.readouterr()
    for choice, message in (
        (["--reference", "0"], "has no depth of '0'; it has that of 1.png, 3.png."),
        (["--reference", "none"], "no photograph is called 'none'"),
        (["--scene", str(twin)], "--scene is for light fields"),
        (["--other", str(tmp_path)], "--other must be what `mvedge stereo` wrote"),
    ):
        assert _main.main(["view", str(twin), *words[2:], *choice]) == 2
        assert message in capsys.readouterr().err


def test_a_reference_is_no_view_of_a_light_field(result, capsys):
    assert _main.main(["view", str(result), "--reference", "1"]) == 2
    assert "--reference is for what `stereo` wrote" in capsys.readouterr().err
