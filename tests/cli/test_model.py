"""`--preset` and `--set`: the model of a command, before anything is compiled."""

import os
import subprocess
import sys

import jax.numpy as jnp
import pytest

from mvedge_jax.cli import _main
from mvedge_jax.cli._model import FULL, ModelOptions, described, read_value, settings_of
from mvedge_jax.diffusion import AutoSolver
from mvedge_jax.lightfield import LightField
from mvedge_jax.posed import StereoDepth
from mvedge_jax.smoothness import ColorAndDepth

COMMANDS = ("depth", "edges", "views", "superpixels", "batch", "sweep", "learn", "optimize")


@pytest.fixture
def light_field():
    return LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))


def test_presets_and_settings_make_the_model(light_field):
    words = (
        "smoothness.color=.3",
        "refine.solves=1",
        "refine.outline=none",
        "solver.tolerance=0",
        "solver.by_residual=false",
    )
    model = ModelOptions("full", words).model(light_field, all_views=True)
    assert isinstance(model.smoothness, ColorAndDepth)
    assert float(model.smoothness.color) == pytest.approx(0.3)
    assert (model.refine.solves, model.refine.outline) == (1, None)
    assert isinstance(model.solver, AutoSolver)
    assert not model.solver.by_residual
    assert model.measurement is not None
    assert model.measurement.views == "all"
    thesis = ModelOptions("thesis", ("edges.lines.alignment=count", "edges.lines.floor=2"))
    report = thesis.described(thesis.model(light_field))
    assert report["preset"] == "thesis"
    assert report["numbers"]["edges.lines.floor"] == 2
    assert report["static fields"]["edges.lines.alignment"] == "count"


def test_later_settings_win():
    assert settings_of(("a.b=1", "c=x=y", "a.b=2.5")) == {"a.b": 2.5, "c": "x=y"}
    words = ("1", "-1e-3", "true", "all", "none")
    assert [read_value(text) for text in words] == [1, -1e-3, True, "all", None]


def test_numbers_of_a_report_are_as_short_as_their_precision():
    report = described(StereoDepth(hypotheses=16))
    assert report["numbers"]["smoothness.color"] == 0.3
    assert report["static fields"]["hypotheses"] == 16


_MISTAKES = [
    ("smoothness.colour=1", "`smoothness.colour` is no path of `EdgeDepth`: the fields of "
     "`ColorAndDepth` are ['color', 'depth', "),
    ("smothness.color=1", "the fields of `EdgeDepth` are ['calibration', 'measurement', 'edges', "),
    ("smoothness.color.more=1", "`smoothness.color.more` is no path of `EdgeDepth`"),
    ("smoothness=1", "`smoothness` is a part, whose numbers and static fields are ['color', "),
    ("searched=1", "`searched` holds a tuple; only numbers, words, true and false can be set"),
    ("smoothness.color=blue", "`smoothness.color` must be a number, got 'blue'"),
    ("smoothness.color=true", "`smoothness.color` must be a number, got True"),
    ("smoothness.color=nan", "`smoothness.color` must be finite and not negative, got nan"),
    ("smoothness.color=-1", "`smoothness.color` must be finite and not negative, got -1"),
    ("refine.solves=1.5", "`refine.solves` must be a whole number, got 1.5"),
    ("refine.solves=0", "`solves` must be at least 1, got 0"),
    ("solver.by_residual=1", "`solver.by_residual` must be true or false, got 1"),
    ("smoothness=none", "`smoothness` is a part, whose numbers and static fields are ['color', "),
    ("refine.solves=none", "`refine.solves` must be a whole number, got None"),
    ("smoothness.color=none", "`smoothness.color` must be a number, got None"),
    ("refine.sharpen.mode=1", "`refine.sharpen.mode` must be a word, got 1"),
    ("refine.solves", "expected PATH=VALUE, such as smoothness.color=0.3"),
    ("refine.solves=", "expected PATH=VALUE, such as smoothness.color=0.3"),
    ("=1", "expected PATH=VALUE, such as smoothness.color=0.3"),
]  # fmt: skip


@pytest.mark.parametrize(("word", "message"), _MISTAKES, ids=[word for word, _ in _MISTAKES])
def test_mistakes_name_the_setting_and_what_there_is(word, message):
    with pytest.raises(ValueError, match="--set ") as error:
        ModelOptions("full", (word,)).check()
    assert message in str(error.value)


def test_a_part_that_a_preset_lacks_is_told(light_field):
    with pytest.raises(ValueError, match="`dense.trust` is no path of `EdgeDepth`"):
        ModelOptions("edges", ("dense.trust=1",)).check()
    with pytest.raises(ValueError, match="`dense` holds None; only numbers"):
        ModelOptions("edges", ("dense=1",)).check()
    for preset in ("edges", "thesis"):
        with pytest.raises(ValueError, match=f"needs dense labels, which preset {preset} does not"):
            ModelOptions(preset).model(light_field, all_views=True)
    FULL.check(all_views=True)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_refuses_before_it_reads(command, tmp_path, capsys):
    (tmp_path / "scene").mkdir()
    words = [command, str(tmp_path / "scene"), str(tmp_path / "out"), "--set", "refine.solvse=1"]
    words += ["--vary", "refine.worse=1:2"] if command == "sweep" else []
    assert _main.main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("mvedge: error: --set refine.solvse: `refine.solvse` is no path of")
    assert [path.name for path in tmp_path.iterdir()] == ["scene"]


def test_the_demo_and_stereo_refuse_as_well(tmp_path, capsys):
    assert _main.main(["demo", str(tmp_path / "out"), "--set", "refine.solves=0"]) == 2
    assert "--set refine.solves: `solves` must be at least 1" in capsys.readouterr().err
    words = ["stereo", str(tmp_path), str(tmp_path / "out"), "--set", "edges.spacing=1"]
    assert _main.main(words) == 2
    assert "--set edges.spacing: `edges.spacing` is no path of `StereoDepth`" in (
        capsys.readouterr().err
    )
    words[-1] = "refine.solves=1"
    assert _main.main([*words, "--method", "points"]) == 2
    assert "--set needs --method dense, got points" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_help_explains_presets_and_settings():
    run = subprocess.run(
        [sys.executable, "-m", "mvedge", "depth", "--help"],
        capture_output=True,
        text=True,
        env={**os.environ, "MVEDGE_CACHE": "off", "COLUMNS": "200"},
        check=True,
    )
    for text in (
        "--preset {full,edges,thesis}",
        "--set PATH=VALUE",
        "smoothness.color=.3",
        "--seed",
    ):
        assert text in run.stdout
