"""Presets: what each is made of, that each gives a map, and what is refused."""

import inspect
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from depth.test_edge_depth import SMALL, small_scene

from mvedge_jax import depth
from mvedge_jax.depth import (
    EdgeDepth,
    NearestLabels,
    SharedLabels,
    SplattedLabels,
    estimate_depth,
)
from mvedge_jax.depth._edge_depth import Preset
from mvedge_jax.depth._presets import PRESETS
from mvedge_jax.edges.sides import (
    BidirectionalSides,
    MapSides,
    NoSides,
    ReprojectionSides,
    ThesisSides,
)
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import AsIs

FLAT = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))


@pytest.fixture(scope="module")
def scene():
    """That of `test_edge_depth`, whose program is shared."""
    return small_scene()


def small(scene, preset, **options):
    choices: dict[str, Any] = dict(SMALL)
    if preset == "thesis":
        choices |= {"edges.lines.capacity": 32}
    return EdgeDepth.for_light_field(
        scene.without_truth(), preset=preset, choices=choices, **options
    )


# The median error and the share of pixels off by more than .3 px that each may have.
@pytest.mark.parametrize(
    ("preset", "median", "bad"), [("full", 0.02, 0.1), ("edges", 0.05, 0.2), ("thesis", 0.3, 0.5)]
)
def test_each_preset_gives_a_map_and_one_trace_serves_changed_numbers(scene, preset, median, bad):
    blind, model, key = scene.without_truth(), small(scene, preset), jax.random.key(0)
    result = model(blind, key=key)
    assert result.disparity.shape == (48, 56)
    assert result.disparity.dtype == blind.views.dtype
    assert bool(jnp.isfinite(result.disparity).all())
    assert bool((result.error > 0).all())
    assert bool(result.stats.converged)
    assert int(result.stats.edges.valid) > 50
    error = np.abs(np.asarray(result.disparity) - np.asarray(scene.truth.disparity))
    assert np.median(error) < median
    assert (error > 0.3).mean() < bad
    # Numbers are traced: Python numbers, arrays and other values share the program.
    before = estimate_depth.traces
    own = "smoothness.depth_edge" if preset == "thesis" else "smoothness.color"
    for choices in ({"refine.stiffness": 6.0}, {own: jnp.asarray(1.0)}):
        other = model.replace(choices)(blind, key=key)
        assert float(jnp.abs(other.disparity - result.disparity).max()) > 1e-5
    assert estimate_depth.traces == before


def test_parts_of_the_presets():
    full, edges, thesis = (EdgeDepth.for_light_field(FLAT, preset=preset) for preset in PRESETS)
    assert (full.dense is None, edges.dense is None, thesis.dense is None) == (False, True, True)
    labels = [type(model.labels) for model in (full, edges, thesis)]
    assert labels == [SharedLabels, SplattedLabels, NearestLabels]
    sides = [type(model.sides) for model in (full, edges, thesis)]
    assert sides == [MapSides, ThesisSides, ThesisSides]
    assert thesis.measurement is None
    assert isinstance(thesis.calibration, AsIs)
    assert get_args(Preset) == PRESETS
    shown = EdgeDepth.for_light_field(FLAT, views="all")
    assert shown.measurement is not None
    assert shown.measurement.views == "all"


@pytest.mark.slow
@pytest.mark.parametrize(
    "sides",
    [ThesisSides(), BidirectionalSides(), ReprojectionSides(radius=4), NoSides()],
    ids=lambda part: type(part).__name__,
)
def test_every_choice_of_sides_gives_a_map(scene, sides):
    model = small(
        scene,
        "edges",
    ).replace(sides=sides, labels=NearestLabels())
    found = model(scene.without_truth())
    error = np.abs(np.asarray(found.disparity) - np.asarray(scene.truth.disparity))
    assert np.median(error) < 0.1
    assert bool(found.stats.converged)
    assert bool((found.surface.score == 0).all()) == isinstance(sides, NoSides)


def test_what_is_no_preset_or_no_choice_is_named():
    # Past the annotations, which are checked in tests only.
    plain: Any = inspect.unwrap(EdgeDepth.for_light_field)
    for act in (plain, inspect.unwrap(depth)):
        with pytest.raises((ValueError, TypeError), match="sparse"):
            act(FLAT, preset="sparse")
    with pytest.raises((ValueError, TypeError), match="some"):
        plain(FLAT, views="some")
    with pytest.raises(ValueError, match=r"`solves` is no path of `EdgeDepth`: the fields of"):
        EdgeDepth.for_light_field(FLAT, choices={"solves": 1})
    with pytest.raises(ValueError, match="`NoneType` has no fields"):
        EdgeDepth.for_light_field(FLAT, preset="edges", choices={"dense.trust": 1.0})
    with pytest.raises(ValueError, match=r"`radius` must be at least 1, got 0"):
        EdgeDepth.for_light_field(FLAT, choices={"measurement.radius": 0})


def test_parts_that_need_a_measurement_say_so():
    """Before a program is compiled: shapes alone are asked for."""
    model = EdgeDepth.for_light_field(FLAT).replace(measurement=None)
    with pytest.raises(ValueError, match="`OrientedEdges` need a `measurement` in the chain"):
        jax.eval_shape(model, FLAT)
    thesis = EdgeDepth.for_light_field(FLAT, preset="thesis")
    with pytest.raises(ValueError, match="`key` must be given for the entropy search"):
        jax.eval_shape(thesis, FLAT)
    still = thesis.replace({"edges.lines.entropy": False, "edges.lines.capacity": 8})
    with pytest.raises(ValueError, match="`SharedLabels` need a `measurement` in the chain"):
        jax.eval_shape(still.replace(labels=SharedLabels()), FLAT)
    with pytest.raises(ValueError, match="dense labels need a `measurement` in the chain"):
        jax.eval_shape(still.replace(dense=EdgeDepth.for_light_field(FLAT).dense), FLAT)
