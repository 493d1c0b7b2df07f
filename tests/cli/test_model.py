"""`--preset` and `--set`: the model of a command, before anything is compiled."""

import jax.numpy as jnp
import pytest

from mvedge_jax.cli._model import FULL, ModelOptions, read_value, settings_of
from mvedge_jax.diffusion import AutoSolver
from mvedge_jax.lightfield import LightField
from mvedge_jax.smoothness import ColorAndDepth


def test_presets_and_settings_make_the_model():
    light_field = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
    words = (
        "smoothness.color=.3",
        "refine.solves=1",
        "refine.outline=none",
        "refine.sharpen.mode=none",
        "solver.tolerance=0",
        "solver.by_residual=false",
    )
    model = ModelOptions("full", words).model(light_field, all_views=True)
    assert isinstance(model.smoothness, ColorAndDepth)
    assert float(model.smoothness.color) == pytest.approx(0.3)
    assert (model.refine.solves, model.refine.outline) == (1, None)
    assert model.refine.sharpen.mode == "none", "a word, not a part that is left out"
    assert isinstance(model.solver, AutoSolver)
    assert not model.solver.by_residual
    assert model.measurement is not None
    assert model.measurement.views == "all"
    thesis = ModelOptions("thesis", ("edges.lines.alignment=count", "edges.lines.floor=2"))
    report = thesis.described(thesis.model(light_field))
    assert report["preset"] == "thesis"
    assert report["numbers"]["edges.lines.floor"] == 2
    assert report["static fields"]["edges.lines.alignment"] == "count"
    FULL.check(all_views=True)


def test_later_settings_win():
    assert settings_of(("a.b=1", "c=x=y", "a.b=2.5")) == {"a.b": 2.5, "c": "x=y"}
    words = ("1", "-1e-3", "true", "all", "none")
    assert [read_value(text) for text in words] == [1, -1e-3, True, "all", None]
