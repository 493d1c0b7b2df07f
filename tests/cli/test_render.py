"""`mvedge render`: a whole scene folder or none at all."""

import numpy as np
import pytest

from mvedge_jax.cli import _main
from mvedge_jax.datasets import load_light_field, synthetic

SIZE = (60, 54)  # the size of tests/datasets/test_synthetic.py, compiled already


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch):
    monkeypatch.setenv("MVEDGE_CACHE", "off")


def run(*words):
    return _main.main(
        ["render", *map(str, words), "--views", "3", "--size", "60", "54", "--samples", "1"]
    )


def test_writes_a_scene_that_loads(tmp_path, capsys):
    out = tmp_path / "made" / "thin"
    assert run("thin", out, "--seed", "3") == 0
    assert str(out) in capsys.readouterr().out
    light_field = load_light_field(out)
    assert light_field.views.shape == (3, 3, *SIZE, 3)
    assert light_field.truth is not None
    assert light_field.truth.view_ids is not None
    masks = list(out.glob("visible_Cam*.png"))
    assert len(masks) == 9
    # Only what is asked for remains; a second run does not replace it unless told.
    assert [path.name for path in out.parent.iterdir()] == ["thin"]
    assert run("thin", out) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert run("crossing", out, "--overwrite", "--no-occlusions", "--textures", "4") == 0
    assert not list(out.glob("visible_Cam*.png"))
    truth = load_light_field(out).truth
    assert truth is not None
    assert truth.object_ids is not None
    assert set(np.unique(truth.object_ids)) == {1, 2}


def test_lenses_of_uneven_brightness_are_asked_for(tmp_path, capsys):
    corners = []
    for words in ((), ("--vignette", "0.4", "--gain", "0.02")):
        assert run("crossing", tmp_path / "out", "--overwrite", "--no-occlusions", *words) == 0
        views = np.asarray(load_light_field(tmp_path / "out").views)
        corners.append(views[..., :6, :6, :].mean((2, 3, 4)))
    ratio = corners[1] / corners[0]
    assert 0.4 < ratio.mean() < 0.85
    assert ratio.std() > 0.01
    assert run("crossing", tmp_path / "out", "--overwrite", "--vignette", "2") == 2
    assert "`vignette` must be between 0 and 1, got 2.0" in capsys.readouterr().err


def test_cameras_farther_apart_are_asked_for(tmp_path, capsys):
    out, maps = tmp_path / "out", []
    for words in ((), ("--baseline", "2.5")):
        assert run("crossing", out, "--overwrite", "--no-occlusions", *words) == 0
        maps.append(load_light_field(out))
    truths = [np.asarray(scene.truth.disparity) for scene in maps]
    np.testing.assert_allclose(truths[1], 2.5 * truths[0], rtol=1e-5, atol=1e-5)
    ranges = [np.asarray(scene.disparity_range) for scene in maps]
    np.testing.assert_allclose(ranges[1], 2.5 * ranges[0], atol=0.01)
    assert run("crossing", out, "--overwrite", "--baseline", "0") == 2
    assert "`baseline` must be positive and finite, got 0.0" in capsys.readouterr().err


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError("disk full"), RuntimeError("bug")])
def test_leaves_nothing_half_written(monkeypatch, tmp_path, error):
    """Interrupted in the middle of writing, after some files are there."""
    from mvedge_jax.datasets import _write_hci

    seen = []
    write_pfm = _write_hci.write_pfm

    def fail(path, array):
        seen.append(sorted(p.name for p in path.parent.iterdir()))
        if len(seen) == 3:
            raise error
        write_pfm(path, array)

    monkeypatch.setattr(_write_hci, "write_pfm", fail)
    code = run("crossing", tmp_path / "out", "--no-occlusions")
    assert code == {KeyboardInterrupt: 130, OSError: 2, RuntimeError: 1}[type(error)]
    assert "input_Cam001.png" in seen[-1]
    assert list(tmp_path.iterdir()) == []


def test_interrupting_the_renderer_leaves_nothing(monkeypatch, tmp_path):
    def interrupt(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(synthetic, "visibility", interrupt)
    assert run("crossing", tmp_path / "out") == 130
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("nosuch", "out"), "must be one of demo, slanted"),
        (("edges", "out", "--views", "4"), None),
        (("edges",), "OUT"),
    ],
)
def test_mistakes_exit_with_two_and_no_traceback(tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    code = _main.main(["render", *words])
    text = capsys.readouterr()
    assert code == 2
    assert "Traceback" not in text.err + text.out
    assert (message or "odd numbers of view rows and columns, got 4x4") in text.err + text.out
    assert list(tmp_path.iterdir()) == []


def test_help_names_every_scene(capsys):
    assert _main.main(["render", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for name in synthetic.scene_names():
        assert name in text
