"""The chain on small views, all by one program: right, robust, and honest where nothing is seen."""

import inspect
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from photometry.scenes import changed, cross_gains

from mvedge_jax import depth
from mvedge_jax._paths import value_at
from mvedge_jax.datasets import synthetic
from mvedge_jax.depth import EdgeDepth, SharedLabels, estimate_depth
from mvedge_jax.edges.thesis import ThesisEdges
from mvedge_jax.lightfield import LightField

SMALL = {"refine.sharpen.levels": 16, "refine.sharpen.radius": 3}
FLAT = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))


def small_scene(name="edges", *, shape=(5, 5, 48, 56), dtype: type = np.float32):
    light_field = synthetic.render(
        synthetic.scene(name), shape=shape, samples=2, key=jax.random.key(0)
    )
    return eqx.tree_at(lambda f: f.views, light_field, light_field.views.astype(dtype))


def small_model(light_field, **options):
    return EdgeDepth.for_light_field(light_field, choices=SMALL, **options)


def off(result, scene):
    """Error of every pixel."""
    return np.abs(np.asarray(result.disparity) - np.asarray(scene.truth.disparity))


@pytest.fixture(scope="module")
def scene():
    return small_scene()


@pytest.fixture(scope="module")
def estimate(scene):
    """Depth of views of the scene's shape and range."""
    model = small_model(scene)
    return lambda views: model(
        LightField(jnp.asarray(views, jnp.float32), disparity_range=scene.disparity_range)
    )


@pytest.fixture(scope="module")
def clean(scene, estimate):
    return estimate(changed(scene).views)


def test_a_scene_with_depth_edges(scene):
    model = small_model(scene)
    result = model(scene)
    assert result.disparity.dtype == scene.views.dtype
    assert bool(jnp.isfinite(result.disparity).all())
    assert bool(result.stats.converged)
    # What parallax moves in so small a frame passes for no vignette.
    assert not bool(result.stats.exposure.uneven)
    error = off(result, scene)
    assert np.median(error) < 0.02
    assert (error > 0.3).mean() < 0.08
    # What is said about the error is true: more than the share of a normal distribution within one.
    assert float(result.error.min()) > 0
    assert (error <= result.error).mean() > 0.68
    # The truth is never read, nor is the name; the same input gives the same output.
    before, blind = estimate_depth.traces, scene.without_truth().renamed("again")
    np.testing.assert_array_equal(model(blind).disparity, result.disparity)
    # Numbers are traced: Python numbers, arrays and other values share the program.
    for choices in ({"refine.stiffness": 6.0}, {"smoothness.color": jnp.asarray(1.0)}):
        other = model.replace(choices)(blind)
        assert float(jnp.abs(other.disparity - result.disparity).max()) > 1e-5
    assert estimate_depth.traces == before


# The median error and the share of pixels off by more than .3 px that each may have.
@pytest.mark.parametrize(("preset", "median", "bad"), [("edges", 0.05, 0.2), ("thesis", 0.3, 0.5)])
def test_the_other_presets_give_a_map(scene, preset, median, bad):
    blind, key = scene.without_truth(), jax.random.key(0)
    lines = {"edges.lines.capacity": 32} if preset == "thesis" else {}
    model = small_model(blind, preset=preset).replace(lines)
    result = model(blind, key=key)
    is_sound(result)
    assert result.disparity.dtype == blind.views.dtype
    assert bool(result.stats.converged)
    assert int(result.stats.edges.valid) > 50
    error = off(result, scene)
    assert np.median(error) < median
    assert (error > 0.3).mean() < bad


def test_all_views_know_more_than_those_of_the_crosshair(scene):
    few, every = (small_model(scene, views=views)(scene) for views in ("crosshair", "all"))
    wrong, less = (off(result, scene) for result in (few, every))
    assert bool(every.stats.converged)
    assert (less > 0.03).mean() < (wrong > 0.03).mean()
    assert np.quantile(less, 0.25) < np.quantile(wrong, 0.25)
    assert (less <= 2 * np.asarray(every.error)).mean() > 0.85


def test_gains_and_darkness_hardly_show(scene, estimate, clean):
    gain = cross_gains()
    result = estimate(changed(scene, gain=gain, factor=0.5).views)
    cross = np.add.outer(np.arange(5) == 2, np.arange(5) == 2)
    found = np.asarray(result.stats.exposure.gain)
    np.testing.assert_allclose(found[cross], gain[cross], rtol=0.01)
    assert float(result.stats.exposure.scale) > 1.2
    assert np.median(off(result, scene)) < 0.02
    assert np.mean(off(result, scene)) < 2 * np.mean(off(clean, scene)) + 0.01


def test_noise_is_reported_and_nothing_overflows(scene, estimate, clean):
    assert float(clean.stats.noise.alpha) < 0.5
    result = estimate(changed(scene, noise=0.05).views)
    assert float(result.stats.noise.alpha) > 0.95
    assert abs(float(result.stats.noise.deviation) / 0.05 - 1) < 0.25
    assert int(result.stats.edges.overflow) == 0
    assert bool(jnp.isfinite(result.disparity).all())
    assert np.median(off(result, scene)) < 0.25


def is_sound(found):
    """Numbers everywhere, and errors."""
    assert bool(jnp.isfinite(found.disparity).all())
    assert bool((found.error > 0).all())


def two_colors(views):
    """The same picture in all views, of two colors."""
    found = np.full_like(views, 0.2)
    found[:, :, :, views.shape[3] // 2 :] = (0.9, 0.6, 0.1)
    return found


@pytest.mark.parametrize("color", [(0.0, 0.0, 0.0), (0.5, 0.4, 0.6), (1.0, 1.0, 1.0)])
def test_without_evidence_the_error_is_as_wide_as_the_range(scene, estimate, color):
    found = estimate(jnp.broadcast_to(jnp.asarray(color), scene.views.shape))
    is_sound(found)
    low, high = map(float, scene.disparity_range)
    assert float(found.error.min()) >= high - low
    assert low - 0.5 <= float(found.disparity.min()) <= float(found.disparity.max()) <= high + 0.5
    said = " ".join(found.problems())
    assert "no edge was found" in said
    assert "half of the pixels have a standard error above" in said


def test_two_colors_and_noise_alone(scene, estimate):
    is_sound(estimate(two_colors(np.asarray(scene.views))))
    found = estimate(np.random.default_rng(0).uniform(size=scene.views.shape))
    is_sound(found)
    assert found.problems()


def test_static_fields_follow_the_range_and_explain_mistakes():
    views = jnp.zeros((9, 9, 32, 32, 3))
    narrow, wide = (
        EdgeDepth.for_light_field(LightField(views, disparity_range=(-r, r))) for r in (1.0, 3.5)
    )
    hypotheses = [value_at(model, "calibration.hypotheses") for model in (narrow, wide)]
    assert hypotheses[1] > 2.5 * hypotheses[0]
    assert [value_at(model, "measurement.radius") for model in (narrow, wide)] == [8, 28]
    assert [model.searched for model in (narrow, wide)] == [(-1.0, 1.0), (-3.5, 3.5)]
    # A model prints its numbers and their units; what is traced has a type instead of a value.
    assert "refine.precision = 0.005 px" in str(narrow).splitlines()
    shown = []
    jax.eval_shape(lambda m: shown.append(str(m)), narrow)
    assert "refine.precision = f64[] px" in shown[0]
    single = LightField(jnp.zeros((1, 1, 8, 8, 3)), disparity_range=(0.0, 1.0))
    spoilt = EdgeDepth.for_light_field(FLAT).replace({"sides.vote.cap": float("nan")})
    anything: Any = estimate_depth
    for call, match in (
        (lambda: narrow.replace({"refine.solves": 0}), "`solves` must be at least 1, got 0"),
        (
            lambda: narrow(LightField(views, disparity_range=(-3.5, 3.5))),
            r"searches disparities from -1 to 1, but .* -3.5 to 3.5",
        ),
        (lambda: EdgeDepth.for_light_field(single), "single view"),
        (lambda: narrow(single), "at least three views.*1x1"),
        (lambda: spoilt(FLAT), "`sides.vote.cap` must be finite and not negative"),
        (
            lambda: anything(narrow, FLAT),
            "`light_field` must be LightField, got EdgeDepth; .*order",
        ),
        (lambda: anything(FLAT, 3.0), "`model` must be EdgeDepth, got 3.0; .*for_light_field"),
    ):
        with pytest.raises((ValueError, TypeError), match=match):
            call()


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
