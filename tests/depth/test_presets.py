"""Presets: what each is made of, that each gives a map, and what is refused."""

import inspect
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from depth.test_edge_depth import FLAT, off, small_model, small_scene

from mvedge_jax import depth
from mvedge_jax._paths import value_at
from mvedge_jax.depth import (
    EdgeDepth,
    NearestLabels,
    SharedLabels,
    SplattedLabels,
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
from mvedge_jax.edges.thesis import ThesisEdges
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import AsIs


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
def test_every_choice_of_sides_gives_a_map(sides):
    scene = small_scene()
    model = small_model(scene, preset="edges").replace(sides=sides, labels=NearestLabels())
    found = model(scene.without_truth())
    assert np.median(off(found, scene)) < 0.1
    assert bool(found.stats.converged)
    assert bool((found.surface.score == 0).all()) == isinstance(sides, NoSides)


def test_what_is_no_preset_or_no_choice_is_named():
    # Past the annotations, which are checked in tests only.
    plain: Any = inspect.unwrap(EdgeDepth.for_light_field)
    chosen = EdgeDepth.for_light_field
    for call, match in (
        (lambda: plain(FLAT, preset="sparse"), "sparse"),
        (lambda: inspect.unwrap(depth)(FLAT, preset="sparse"), "sparse"),
        (lambda: plain(FLAT, views="some"), "some"),
        (lambda: chosen(FLAT, choices={"solves": 1}), "`solves` is no path of `EdgeDepth`: the f"),
        (
            lambda: chosen(FLAT, preset="edges", choices={"dense.trust": 1.0}),
            "`NoneType` has no fields",
        ),
        (
            lambda: chosen(FLAT, choices={"measurement.radius": 0}),
            "`radius` must be at least 1, got 0",
        ),
    ):
        with pytest.raises((ValueError, TypeError), match=match):
            call()


def test_parts_that_need_a_measurement_say_so():
    """Before a program is compiled: shapes alone are asked for."""
    full = EdgeDepth.for_light_field(FLAT)
    thesis = EdgeDepth.for_light_field(FLAT, preset="thesis")
    still = thesis.replace({"edges.lines.entropy": False, "edges.lines.capacity": 8})
    for model, match in (
        (full.replace(measurement=None), "`OrientedEdges` need a `measurement` in the chain"),
        (thesis, "`key` must be given for the entropy search"),
        (still.replace(labels=SharedLabels()), "`SharedLabels` need a `measurement` in the chain"),
        (still.replace(dense=full.dense), "dense labels need a `measurement` in the chain"),
    ):
        with pytest.raises(ValueError, match=match):
            jax.eval_shape(model, FLAT)


def test_numbers_in_px_per_view_step_grow_where_views_are_few():
    def model(views, **options):
        flat = LightField(jnp.full((views, views, 8, 8, 3), 0.5), disparity_range=(-1.0, 1.0))
        return EdgeDepth.for_light_field(flat, **options)

    many, few = model(9), model(3)
    assert float(many.refine.precision) == pytest.approx(0.005)
    for path in ("refine.precision", "smoothness.depth", "edges.error_limit", "dense.agreement"):
        assert float(value_at(few, path)) == pytest.approx(4 * float(value_at(many, path)))
    same = "measurement.same_surface"
    assert float(value_at(few, same)) == pytest.approx(2 * float(value_at(many, same)))
    # What is chosen stays as chosen; distances in the image are none of disparities.
    chosen = model(3, choices={"refine.precision": 0.007})
    assert float(chosen.refine.precision) == pytest.approx(0.007)
    assert few.refine.error.forgotten == many.refine.error.forgotten
    assert model(11).refine.precision == many.refine.precision
    assert isinstance(model(3, preset="thesis").edges, ThesisEdges)
    assert model(3, preset="thesis").refine.precision == many.refine.precision
