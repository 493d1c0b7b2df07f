"""`mvedge render`: a whole scene folder or none at all."""

import numpy as np
import pytest

from mvedge_jax.datasets import _write_hci, load_light_field, synthetic

SIZE = (60, 54)  # the size of tests/datasets/test_synthetic.py, compiled already


@pytest.fixture
def render(mvedge):
    def run(scene, out, *words, code=0):
        size = ("--views", 3, "--size", *SIZE, "--samples", 1)
        return mvedge("render", scene, out, *words, *size, code=code)

    return run


def test_writes_a_scene_that_loads(tmp_path, render):
    out = tmp_path / "made" / "thin"
    assert str(out) in render("thin", out, "--seed", 3).out
    light_field = load_light_field(out)
    assert light_field.views.shape == (3, 3, *SIZE, 3)
    assert light_field.truth is not None
    assert light_field.truth.view_ids is not None
    assert len(list(out.glob("visible_Cam*.png"))) == 9
    # Only what is asked for remains.
    assert [path.name for path in out.parent.iterdir()] == ["thin"]
    render("crossing", out, "--overwrite", "--no-occlusions", "--textures", 4)
    assert not list(out.glob("visible_Cam*.png"))
    truth = load_light_field(out).truth
    assert truth is not None
    assert truth.object_ids is not None
    assert set(np.unique(truth.object_ids)) == {1, 2}


def test_uneven_lenses_and_cameras_farther_apart_are_asked_for(tmp_path, render):
    fields = []
    for words in ((), ("--vignette", 0.4, "--gain", 0.02), ("--baseline", 2.5)):
        render("crossing", tmp_path / "out", "--overwrite", "--no-occlusions", *words)
        fields.append(load_light_field(tmp_path / "out"))
    plain, uneven, apart = fields
    corners = [np.asarray(f.views)[..., :6, :6, :].mean((2, 3, 4)) for f in (uneven, plain)]
    ratio = corners[0] / corners[1]
    assert 0.4 < ratio.mean() < 0.85
    assert ratio.std() > 0.01
    truths = [np.asarray(field.truth.disparity) for field in (apart, plain)]
    np.testing.assert_allclose(truths[0], 2.5 * truths[1], rtol=1e-5, atol=1e-5)
    ranges = [np.asarray(field.disparity_range) for field in (apart, plain)]
    np.testing.assert_allclose(ranges[0], 2.5 * ranges[1], atol=0.01)


@pytest.mark.parametrize(("error", "code"), [(KeyboardInterrupt(), 130), (RuntimeError("bug"), 1)])
def test_leaves_nothing_half_written(monkeypatch, tmp_path, render, error, code):
    """Interrupted in the middle of writing, after some files are there."""
    seen, write_pfm = [], _write_hci.write_pfm

    def fail(path, array):
        seen.append(sorted(p.name for p in path.parent.iterdir()))
        if len(seen) == 3:
            raise error
        write_pfm(path, array)

    monkeypatch.setattr(_write_hci, "write_pfm", fail)
    render("crossing", tmp_path / "out", "--no-occlusions", code=code)
    assert "input_Cam001.png" in seen[-1]
    assert list(tmp_path.iterdir()) == []


def test_interrupting_the_renderer_leaves_nothing(monkeypatch, tmp_path, render):
    def interrupt(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(synthetic, "visibility", interrupt)
    render("crossing", tmp_path / "out", code=130)
    assert list(tmp_path.iterdir()) == []
