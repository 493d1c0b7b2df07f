import csv
import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from datasets.layouts import write_hci

from mvedge_jax._paths import value_at
from mvedge_jax.cli import _main
from mvedge_jax.cli._model import ModelOptions
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.learn import Learned
from mvedge_jax.lightfield import LightField


@pytest.fixture
def scenes(tmp_path):
    views = np.full((3, 3, 8, 8, 3), 128, np.uint8)
    truth = np.zeros((8, 8), np.float32)
    return [write_hci(tmp_path / name, views, disparity=truth) for name in ("a", "b", "c")]


@pytest.fixture
def asked(monkeypatch):
    """What `learn` is called with, in place of learning; `smoothness.color` is doubled."""
    calls = []

    def learn(model, what, fields, *, validation, progress, **options):
        calls.append((model, what, fields, validation, options))
        color = 2 * value_at(model, "smoothness.color")
        found = model.replace({"smoothness.color": color})
        curves = np.asarray([3.0, 2.0]), [] if validation is None else [(0, 3.0), (2, 2.5)]
        return Learned(found, model, {"smoothness.color": color}, *curves, 2)

    monkeypatch.setattr("mvedge_jax.cli._learn.learn_from", learn)
    return calls


def test_random_scenes_are_learned_from(asked, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["learn", str(out), "--random", "5", "--size", "16", "--views", "3", "--validation"]
    words += ["2", "--preset", "edges", "--what", "smoothness", "--range", "-1", "1"]
    assert _main.main([*words, "--steps", "7"]) == 0
    ((model, what, fields, held, options),) = asked
    assert (what, len(fields), len(held)) == (("smoothness",), 5, 2)
    assert fields[0].views.shape == (3, 3, 16, 16, 3)
    assert not np.array_equal(fields[0].views, held[0].views)
    assert model.dense is None
    assert options["checkpoint"] == tmp_path / "out.checkpoint"
    assert options["steps"] == 7
    learned = json.loads((out / "learned.json").read_text())
    assert learned["preset"] == "edges"
    assert learned["factors"] == {"smoothness.color": pytest.approx(2)}
    with (out / "curves.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["step"], row["validation"]) for row in rows] == [
        ("0", "3.0"),
        ("1", ""),
        ("2", "2.5"),
    ]
    assert (out / "learning.png").stat().st_size > 10_000
    assert json.loads((out / "report.json").read_text())["best step"] == 2
    said = capsys.readouterr().out
    assert "validation 3 -> 2.5, step 2" in said
    assert "smoothness.color = 0.6 (x 2)" in said


def test_files_are_learned_from_and_the_last_ones_held_out(asked, scenes, tmp_path):
    words = ["learn", *map(str, scenes), str(tmp_path / "out"), "--validation", "1"]
    assert _main.main(words) == 0
    ((_, what, fields, held, _),) = asked
    assert what == ("smoothness", "refine")
    assert [field.name for field in fields] == ["a", "b"]
    assert [field.name for field in held] == ["c"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["--what", "smoothness.colour"],
            "`smoothness.colour` is no path of `EdgeDepth`: the fields of `Col",
        ),
        (["--what", "refine.solves"], "`refine.solves` holds 2; only numbers and arrays can be"),
        (["--rate", "0"], "--rate must be positive, got 0.0"),
        (["--validation", "-1"], "--validation must not be negative, got -1"),
        (["--random", "0"], "`count` must be at least 1, got 0"),
    ],
)
def test_mistakes_are_told_before_anything_is_written(asked, words, message, tmp_path, capsys):
    assert _main.main(["learn", str(tmp_path / "out"), *words]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    assert not asked


def test_no_scene_is_left_or_has_no_truth(asked, scenes, tmp_path, capsys):
    words = ["learn", *map(str, scenes), str(tmp_path / "out")]
    assert _main.main([*words, "--validation", "3"]) == 2
    assert "--validation 3 leaves none of 3 scenes to learn from" in capsys.readouterr().err
    blind = write_hci(tmp_path / "d", np.full((3, 3, 8, 8, 3), 128, np.uint8))
    assert _main.main(["learn", str(scenes[0]), str(blind), str(tmp_path / "out")]) == 2
    assert f"{blind} has no ground truth to learn from" in capsys.readouterr().err
    assert not asked


def file(folder: Path, **content) -> Path:
    path = folder / "learned.json"
    path.write_text(json.dumps(content))
    return path


def test_factors_multiply_what_the_views_ask_for(tmp_path):
    path = file(tmp_path, preset="edges", factors={"refine.precision": 2.0})
    for views in (3, 9):
        field = LightField(jnp.full((views, views, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
        plain = EdgeDepth.for_light_field(field, preset="edges")
        found = ModelOptions("edges", (), path).model(field)
        assert float(found.refine.precision) == pytest.approx(2 * float(plain.refine.precision))
        words = ("refine.precision=.125",)
        assert float(ModelOptions("edges", words, path).model(field).refine.precision) == 0.125


def test_the_setting_of_a_sweep_is_taken_as_it_is(tmp_path):
    path = file(tmp_path, preset="full", setting={"refine.precision": 0.25, "refine.solves": 1})
    found = ModelOptions(learned=path).check()
    assert float(found.refine.precision) == 0.25
    assert found.refine.solves == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"preset": "full", "factors": {}}, "it is for --preset full, not edges"),
        ({"preset": "edges"}, "expected learned.json of `mvedge learn` or best.json of `mvedge"),
        ({"preset": "edges", "factors": {"worse": 1}}, "`worse` is no path of `EdgeDepth`"),
        ({"preset": "edges", "factors": {"refine": 1}}, "float() argument must be"),
        ({"preset": "edges", "factors": {"refine.precision": -1}}, "must be finite and not neg"),
        ({"preset": "edges", "factors": [1]}, "has no attribute"),
        ({"preset": "edges", "setting": {"refine.solves": 0}}, "`solves` must be at least 1"),
    ],
)
def test_a_file_that_does_not_fit_is_told(tmp_path, content, message):
    path = file(tmp_path, **content)
    with pytest.raises(ValueError, match="--model ") as error:
        ModelOptions("edges", (), path).check()
    assert str(path) in str(error.value)
    assert message in str(error.value)


def test_a_file_that_is_not_there_or_no_json_is_told(tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no such file"):
        ModelOptions("edges", (), tmp_path / "none").check()
    (tmp_path / "deep").write_text("[" * 200_000)
    with pytest.raises(ValueError, match="--model .*deep: "):
        ModelOptions("edges", (), tmp_path / "deep").check()
    (tmp_path / "text").write_text("no json")
    with pytest.raises(ValueError, match="--model .*text: Expecting value"):
        ModelOptions("edges", (), tmp_path / "text").check()
