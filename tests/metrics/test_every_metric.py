"""What every metric keeps: values that are not finite, masks, transforms, precision, errors."""

import inspect
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import count_traces
from scipy import ndimage

from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import (
    boundary_scores,
    calibration,
    depth_scores,
    reprojection_error,
    view_consistency,
    view_consistency_map,
)
from mvedge_jax.metrics.depth import bad_pixels, mae, mse, q25
from mvedge_jax.metrics.superpixels import superpixel_scores


def _bad(disparity, truth, **options):
    return bad_pixels(disparity, truth, 0.5, **options)


def _boundary(disparity, truth, **options):
    """What is better if it is less, as the other metrics."""
    found = boundary_scores(disparity, truth, **options)
    return -jnp.stack([found.mean_f1, found.auc, found.precision.min(), found.recall.min()])


def _lab(disparity, field):
    return reprojection_error(disparity, field, space="lab").error


def _rgb(disparity, field):
    return reprojection_error(disparity, field).error


def _consistency(disparity, maps):
    return view_consistency(maps.at[1, 1].set(disparity)).per_view


TO_TRUTH = {"mse": mse, "mae": mae, "q25": q25, "bad": _bad, "boundary": _boundary}
BY_VIEWS = {"rgb": _rgb, "lab": _lab, "consistency": _consistency}


def _case(name, shape=(13, 18)) -> Any:
    """A metric, a map to score, what it is scored by, and pixels that count."""
    rng = np.random.default_rng(3)
    truth = np.kron(rng.normal(size=(4, 5)), np.ones((4, 4)))[: shape[0], : shape[1]]
    disparity = jnp.asarray(ndimage.gaussian_filter(truth, 0.8) + 0.1 * rng.normal(size=shape))
    mask, other = jnp.asarray(rng.random(shape) < 0.7), jnp.asarray(truth)
    if name == "consistency":
        other = jnp.asarray(np.asarray(disparity) + 0.01 * rng.normal(size=(3, 3, *shape)))
    elif name in BY_VIEWS:
        views = ndimage.gaussian_filter(rng.random((3, 3, *shape, 3)), (0, 0, 1, 1, 0))
        other = LightField(jnp.asarray(views))
    return (TO_TRUTH | BY_VIEWS)[name], disparity, other, mask


@pytest.mark.parametrize("name", TO_TRUTH | BY_VIEWS)
@pytest.mark.parametrize("value", [jnp.nan, jnp.inf, -jnp.inf])
def test_values_that_are_not_finite_never_improve_a_score(name, value):
    metric, disparity, other, _ = _case(name)
    before = metric(disparity, other)
    for seed in range(4):
        hole = jnp.asarray(np.random.default_rng(seed).random(disparity.shape) < 0.1)
        after = metric(jnp.where(hole, value, disparity), other)
        assert bool(jnp.all(after >= before))
        assert bool(jnp.any(after > before)) or name in ("q25", "bad")
    if name in ("mse", "mae", "q25"):
        assert metric(jnp.full_like(disparity, value), other) == jnp.inf


@pytest.mark.parametrize("name", TO_TRUTH)
def test_what_is_not_counted_changes_nothing(name):
    metric, disparity, truth, mask = _case(name)
    expected = metric(disparity, truth, mask=mask)
    spoilt = jnp.where(mask, disparity, jnp.nan), jnp.where(mask, truth, jnp.nan)
    np.testing.assert_array_equal(metric(*spoilt, mask=mask), expected)
    ring = disparity.at[0].set(jnp.nan).at[:, -1].set(jnp.inf)
    expected = metric(disparity, truth, crop=1)
    np.testing.assert_array_equal(metric(ring, truth.at[-1].set(9.0), crop=1), expected)
    nothing = metric(disparity, truth, mask=jnp.zeros_like(mask))
    assert bool(jnp.isnan(jnp.ravel(nothing)[0]))


@pytest.mark.parametrize("name", TO_TRUTH | BY_VIEWS)
def test_one_trace_vmap_and_single_precision(name):
    metric, disparity, other, _ = _case(name)
    counted, traces = count_traces(metric)
    stack = jnp.stack([disparity, 0.5 * disparity, disparity + 1])
    loop = jnp.stack([counted(d, other) for d in stack])
    assert traces() == 1
    np.testing.assert_allclose(metric(disparity, other), loop[0])
    np.testing.assert_allclose(jax.vmap(lambda d: metric(d, other))(stack), loop)
    single = metric(*(jax.tree.map(_single, tree) for tree in (disparity, other)))
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, loop[0], rtol=2e-3)


def _single(leaf):
    return leaf.astype(jnp.float32) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf


def test_single_precision_is_enough_for_the_printed_digits():
    _, disparity, truth, mask = _case("mse", (16, 20))
    large = [jnp.tile(maps, (12, 10)) for maps in (disparity, truth, mask)]
    single = depth_scores(*map(_single, large[:2]), mask=large[2])
    for ours, exact in zip(single, depth_scores(*large[:2], mask=large[2]), strict=True):
        np.testing.assert_allclose(ours, exact, rtol=2e-5)


MAP, OTHER = jnp.zeros((4, 5)), jnp.zeros((5, 5))
GRID = jnp.zeros((3, 3, 4, 5))
LABELS = jnp.zeros((3, 3, 4, 5), jnp.int32)
FIELD = LightField(jnp.zeros((3, 3, 4, 5, 3)))
CORNERLESS = jnp.asarray([[0, 1, 0], [1, 1, 1], [0, 1, 0]], bool)
CROSSHAIR = LightField(jnp.zeros((3, 3, 4, 5, 3)), available=CORNERLESS)


@pytest.mark.parametrize(
    ("metric", "arguments", "options", "message"),
    [
        (mse, (MAP, OTHER), {}, "`truth` must have the shape"),
        (mse, (MAP, MAP), {"mask": jnp.ones((4, 4), bool)}, "`mask` must"),
        (mse, (MAP, MAP), {"crop": 2}, "`crop` must"),
        (mse, (MAP, MAP), {"crop": -1}, "`crop` must"),
        (boundary_scores, (MAP, OTHER), {}, "`truth` must have the shape"),
        (calibration, (MAP, MAP, MAP), {}, "`error` must be positive; 20 of 20"),
        (calibration, (MAP, OTHER, MAP), {}, "`error` must have the shape of `disparity`"),
        (calibration, (MAP, MAP + 1, MAP), {"groups": 0}, "`groups` must be at least 1, got 0"),
        (
            calibration,
            (MAP.at[3, 4].set(jnp.nan), MAP + 1, MAP),
            {},
            "`disparity` must be finite; 1 of",
        ),
        (view_consistency, (GRID[0],), {}, "`disparities` must have the axes"),
        (view_consistency, (GRID,), {"available": jnp.ones((2, 3), bool)}, "`available` must have"),
        (view_consistency, (GRID,), {"crop": 2}, "`crop` must"),
        (view_consistency, (GRID,), {"stride": 0}, "`stride` must"),
        (view_consistency_map, (GRID, (-1, -1)), {}, "`view` must be one of the 3x3 views, got"),
        (view_consistency_map, (GRID, (3, 0)), {}, "`view` must be one of the 3x3 views, got"),
        (reprojection_error, (OTHER, FIELD), {}, "`disparity` must have the size of the views"),
        (reprojection_error, (MAP, FIELD), {"targets": ((0, 5),)}, "asks for view"),
        (reprojection_error, (MAP, FIELD), {"crop": 2}, "`crop` must"),
        (reprojection_error, (MAP, FIELD), {"space": "hsv"}, "`space` must"),
        (reprojection_error, (MAP, CROSSHAIR), {}, "the crosshair"),
        (superpixel_scores, (LABELS[0], LABELS, GRID), {}, "`labels` must have the axes"),
        (superpixel_scores, (LABELS, LABELS[:1], GRID), {}, "`object_ids` must have the shape of"),
        (superpixel_scores, (LABELS, LABELS, GRID[..., :3]), {}, "`disparity` must have the shape"),
        (superpixel_scores, (LABELS - 1, LABELS, GRID), {}, "`labels` must be at least 0, got -1"),
    ],
)
def test_bad_input_says_what_is_wrong(metric, arguments, options, message):
    with pytest.raises(ValueError, match=message):
        inspect.unwrap(metric)(*arguments, **options)  # as users call it: without the type checker


@pytest.mark.parametrize("metric", [depth_scores, boundary_scores])
def test_what_is_no_map_is_named(metric):
    for maps, message in (
        ((FIELD, MAP), "`disparity` must be a map .*`result.disparity`, got LightField"),
        ((MAP, FIELD), "`truth` must be a map .*`light_field.truth.disparity`, got LightField"),
    ):
        with pytest.raises(TypeError, match=message):
            inspect.unwrap(metric)(*maps)


def test_what_is_masked_or_not_asked_for_may_be_anything():
    spoilt, mask = MAP.at[3, 4].set(jnp.nan), jnp.ones((4, 5), bool).at[3, 4].set(False)
    assert float(calibration(spoilt, MAP + 1, MAP, mask=mask).within[0]) == 1
    ends = reprojection_error(MAP, CROSSHAIR, targets=((1, 0), (2, 1)))
    assert np.isfinite(ends.error)
