import csv
import json

import jax.numpy as jnp
import numpy as np
import pytest
from cli.scenes import gray_scenes

from mvedge_jax._paths import value_at
from mvedge_jax.cli._model import ModelOptions
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.learn import Learned
from mvedge_jax.lightfield import LightField


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

    monkeypatch.setattr("mvedge_jax.cli._learn_seed.learn_from", learn)
    return calls


def test_random_scenes_are_learned_from(asked, tmp_path, mvedge):
    out = tmp_path / "out"
    words = ["learn", out, "--random", 5, "--size", 16, "--views", 3, "--validation", 2]
    words += ["--preset", "edges", "--what", "smoothness", "--range", -1, 1, "--steps", 7]
    said = mvedge(*words).out
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
        rows = [(row["step"], row["validation"]) for row in csv.DictReader(file)]
    assert rows == [("0", "3.0"), ("1", ""), ("2", "2.5")]
    assert (out / "learning.png").stat().st_size > 10_000
    assert json.loads((out / "report.json").read_text())["best step"] == 2
    assert "validation 3 -> 2.5, step 2" in said
    assert "smoothness.color = 0.6 (x 2)" in said


def test_files_are_learned_from_and_the_last_ones_held_out(asked, tmp_path, mvedge):
    scenes = gray_scenes(tmp_path, "abc")
    mvedge("learn", *scenes, tmp_path / "out", "--validation", 1)
    ((_, what, fields, held, _),) = asked
    assert what == ("smoothness", "refine")
    assert [field.name for field in fields] == ["a", "b"]
    assert [field.name for field in held] == ["c"]


def test_every_seed_is_a_run_of_its_own(asked, tmp_path, mvedge):
    out = tmp_path / "out"
    words = ["learn", out, "--random", 3, "--size", 16, "--views", 3, "--validation", 1]
    words += ["--preset", "edges", "--seeds", 4, 7]
    said = mvedge(*words).out
    (first, second) = asked
    assert not np.array_equal(first[2][0].views, second[2][0].views)
    kept = [call[4]["checkpoint"] for call in asked]
    assert kept == [tmp_path / "out.checkpoint" / name for name in ("seed_4", "seed_7")]
    assert "seed_7: validation 3 -> 2.5, step 2" in said
    assert "2 of 2 seeds done" in said
    assert json.loads((out / "seed_7" / "report.json").read_text())["seed"] == 7
    with (out / "summary.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["name"], row["state"]) for row in rows] == [("seed_4", "done"), ("seed_7", "done")]
    assert (rows[0]["validation before"], rows[0]["validation after"]) == ("3.0", "2.5")

    mvedge(*words, 9)
    assert len(asked) == 3
    again = json.loads((out / "summary.json").read_text())
    states = {name: row["state"] for name, row in again.items()}
    assert states == {"seed_4": "there already", "seed_7": "there already", "seed_9": "done"}


def test_a_seed_that_fails_stops_no_other(asked, tmp_path, mvedge):
    out = tmp_path / "out"
    (out / "seed_1").mkdir(parents=True)
    (out / "seed_1" / "mine.txt").touch()
    words = ["learn", out, "--random", 2, "--size", 16, "--views", 3, "--preset", "edges"]
    said = mvedge(*words, "--seeds", 1, 2, code=1)
    assert "1 of 2 seeds done" in said.out
    rows = json.loads((out / "summary.json").read_text())
    assert rows["seed_1"]["state"] == "failed"
    assert "seed_1" in rows["seed_1"]["reason"]
    assert rows["seed_2"]["state"] == "done"


@pytest.mark.parametrize("seeds", [(1, 1), ()])
def test_seeds_differ(seeds, tmp_path, mvedge):
    said = mvedge("learn", tmp_path / "out", "--seeds", *seeds, code=2)
    assert "--seeds must be different numbers" in said.err


def _file(folder, text):
    path = folder / "learned.json"
    path.write_text(text if isinstance(text, str) else json.dumps(text))
    return path


def test_factors_multiply_what_the_views_ask_for(tmp_path):
    path = _file(tmp_path, {"preset": "edges", "factors": {"refine.precision": 2.0}})
    for views in (3, 9):
        field = LightField(jnp.full((views, views, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
        plain = EdgeDepth.for_light_field(field, preset="edges")
        found = ModelOptions("edges", (), path).model(field)
        assert float(found.refine.precision) == pytest.approx(2 * float(plain.refine.precision))
        words = ("refine.precision=.125",)
        assert float(ModelOptions("edges", words, path).model(field).refine.precision) == 0.125


def test_weights_of_a_network_are_taken_as_they_are(tmp_path):
    where, plain = "dense.network.last.bias", ModelOptions("learned").check()
    numbers = {where: [[[0.25]]], "dense.trust": 2.0}
    path = _file(tmp_path, {"preset": "learned", "factors": {"dense.trust": 2}, "numbers": numbers})
    found = ModelOptions("learned", (), path).check()
    assert float(np.ravel(value_at(found, where))[0]) == 0.25
    before, after = (float(value_at(model, "dense.trust")) for model in (plain, found))
    assert after == pytest.approx(2 * before)
    _file(tmp_path, {"preset": "learned", "factors": {}, "numbers": {where: [[[float("nan")]]]}})
    with pytest.raises(ValueError, match=r"`dense.network.last.bias` must be finite"):
        ModelOptions("learned", (), path).check()


def test_the_setting_of_a_sweep_is_taken_as_it_is(tmp_path):
    setting = {"refine.precision": 0.25, "refine.solves": 1}
    path = _file(tmp_path, {"preset": "full", "setting": setting})
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
        (
            {"preset": "edges", "factors": {}, "numbers": {"smoothness.color": [1.0, 2.0]}},
            "`smoothness.color` has the shape () in the model, not (2,)",
        ),
        ({"preset": "edges", "setting": {"refine.solves": 0}}, "`solves` must be at least 1"),
        pytest.param("[" * 200_000, "", id="deep"),
        ("no json", "Expecting value"),
    ],
)
def test_a_file_that_does_not_fit_is_told(tmp_path, content, message):
    path = _file(tmp_path, content)
    with pytest.raises(ValueError, match="--model ") as error:
        ModelOptions("edges", (), path).check()
    assert str(path) in str(error.value)
    assert message in str(error.value)
