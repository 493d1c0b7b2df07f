"""The light field's invariants, slices and resampling."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mvedge_jax import Camera, GroundTruth, LightField
from mvedge_jax._crosshair import crosshair


def _random(v=3, u=5, y=6, x=8, **kwargs):
    views = jax.random.uniform(jax.random.key(0), (v, u, y, x, 3))
    return LightField(views, **kwargs)


def test_epis_steps_and_crops_follow_the_convention():
    field = _random()
    horizontal, vertical = field.horizontal_epis(), field.vertical_epis()
    assert horizontal.shape == (6, 5, 8, 3)
    assert vertical.shape == (8, 3, 6, 3)
    np.testing.assert_array_equal(horizontal[4, 1], field.views[1, 1, 4])
    np.testing.assert_array_equal(vertical[7, 2], field.views[2, 2, :, 7])
    assert field.steps.shape == (3, 5, 2)
    np.testing.assert_array_equal(field.steps[0, 4], [-2, 1])
    np.testing.assert_array_equal(field.steps[1, 2], [0, 0])
    np.testing.assert_array_equal(field.crop_views(1, 3).views, field.views[1:2, 1:4])
    for count in (2, 0, 7):
        with pytest.raises(ValueError, match=f"odd and between 1 and the 3 .* got {count}"):
            field.crop_views(count)


def test_downsampling_averages_areas_and_scales_disparity():
    disparity = jnp.arange(48.0).reshape(6, 8)
    truth = GroundTruth(disparity, disparity != 9, jnp.arange(48).reshape(6, 8))
    camera = Camera(focal_px=100.0, baseline=0.1, focus_distance=2.0)
    field = _random(truth=truth, camera=camera, disparity_range=(-1.0, 3.0))
    half = field.downsample(2)
    assert half.views.shape == (3, 5, 3, 4, 3)
    np.testing.assert_allclose(half.views[1, 2, 1, 3], field.views[1, 2, 2:4, 6:8].mean((0, 1)))
    assert half.truth is not None
    assert half.camera is not None
    np.testing.assert_allclose(half.truth.disparity[0, 1], np.mean([2, 3, 10, 11]) / 2)
    np.testing.assert_array_equal(half.truth.valid[0], [False, True, True, True])
    np.testing.assert_array_equal(half.disparity_range, [-0.5, 1.5])
    # The same point of the world has the same depth at both sizes.
    near, far = half.camera.depth(jnp.asarray(0.35)), camera.depth(jnp.asarray(0.7))
    np.testing.assert_allclose(near, far, rtol=1e-12)
    assert field.downsample(1) is field
    assert field.downsample(5).views.shape == (3, 5, 1, 1, 3)
    with pytest.raises(ValueError, match="`factor` must be between 1 and the shorter side, 6"):
        field.downsample(7)


def test_camera_converts_there_and_back():
    camera = Camera(focal_px=500.0, baseline=0.01, focus_distance=4.0)
    depth = jnp.array([1.0, 4.0, 9.0])
    disparity = camera.disparity(depth)
    assert disparity[1] == 0
    assert (jnp.diff(disparity) < 0).all()
    np.testing.assert_allclose(camera.depth(disparity), depth, rtol=1e-12)
    assert jnp.isinf(camera.depth(jnp.array(-5.0)))


def test_what_else_is_known_compiles_nothing_anew():
    truth = GroundTruth(jnp.zeros((6, 8)), jnp.ones((6, 8), bool))
    camera = Camera(100.0, 0.1, 2.0)
    assert _random(truth=truth).without_truth().without_truth().truth is None
    known = _random(truth=truth, camera=camera, disparity_range=(-1.0, 1.0), name="known")
    named = known.renamed("other")
    assert named.name == "other"
    for a, b in zip(jax.tree.leaves(named), jax.tree.leaves(known), strict=True):
        assert a is b
    traces = []
    run = jax.jit(lambda f: traces.append(f) or f.center_view.sum())
    for field in (known, named, known.without_truth(), _random(name="a")):
        bare = field.bare()
        assert (bare.truth, bare.camera, bare.disparity_range) == (None, None, None)
        assert bare.views is field.views
        assert bare.available is field.available
        run(bare)
    assert len(traces) == 1
    # Under a transform, too, and its derivative reaches the views.
    gradient = jax.grad(lambda v: LightField(v, name="x").bare().views.sum())(known.views)
    np.testing.assert_array_equal(gradient, 1)


GRAY = np.full((3, 3, 4, 4, 3), 0.5, np.float32)
TRUE = jnp.ones((4, 4), bool)


@pytest.mark.parametrize(
    ("views", "options", "message"),
    [
        (GRAY[0], {}, r"axes \[v, u, y, x, c\].*\(3, 4, 4, 3\)"),
        (GRAY[:, :2], {}, "odd number of view rows and columns.*3x2"),
        (np.zeros((3, 3, 4, 4, 3), np.uint8), {}, "floating point.*uint8"),
        (GRAY.astype("f2"), {}, "must be float32 or float64, got float16"),
        (GRAY.astype("c8"), {}, "floating point.*complex64"),
        (np.zeros((3, 3, 4, 4, 4)), {}, "three color channels, got 4"),
        (GRAY[:, :, :0], {}, "must not be empty"),
        (255 * GRAY, {}, "from 127.5 to 127.5"),
        (GRAY, {"disparity_range": (1.0, -1.0)}, "low < high"),
        (GRAY, {"disparity_range": (np.nan, 1.0)}, "disparity_range"),
        (GRAY, {"disparity_range": (-np.inf, 1.0)}, "disparity_range"),
        (GRAY, {"disparity_range": (1.0, 2.0, 3.0)}, "pair"),
        (GRAY, {"available": jnp.ones((3, 5))}, "shape of the view grid"),
        (
            GRAY,
            {"available": jnp.ones((3, 3)).at[1, 1].set(0)},
            r"the center view, \(v, u\) = \(1, 1\), which is missing",
        ),
        (
            jnp.zeros((3, 5, 4, 4, 3)),
            {"available": jnp.zeros((3, 5)).at[0].set(1).at[0, 2].set(0).at[1, 2].set(1)},
            "a view of the crosshair.*all 6 are missing",
        ),
        (GRAY, {"truth": GroundTruth(jnp.zeros((4, 5)), jnp.ones((4, 5), bool))}, "size of the"),
        (GRAY, {"truth": GroundTruth(jnp.full((4, 4), jnp.nan), TRUE)}, "finite where"),
    ],
)
def test_bad_input_is_refused(views, options, message):
    with pytest.raises((ValueError, TypeError), match=message):
        LightField(views, **options)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_single_bad_value_in_many_is_found(value, dtype):
    """Large arrays lose NaN in minima and maxima on some CPUs; each draw puts it elsewhere."""
    rng = np.random.default_rng(0)
    clean = rng.uniform(size=(5, 5, 48, 48, 3)).astype(dtype)
    for _ in range(20):
        v, u, y, x, c = (int(rng.integers(side)) for side in clean.shape)
        views = clean.copy()
        views[v, u, y, x, c] = value
        place = rf"1 values.*view \(v, u\) = \({v}, {u}\) at \(x, y\) = \({x}, {y}\)"
        with pytest.raises(ValueError, match=place):
            LightField(views)


def _places(columns=(-2, -1, 0, 1.4, 2), rows=(-1.5, 0, 1.5)):
    return np.stack(np.meshgrid(columns, rows), axis=-1)


def test_positions_move_points_as_far_as_they_are_away():
    field = _random(positions=_places())
    np.testing.assert_allclose(field.steps[0, 3], [-1.4, 1.5], rtol=1e-6)
    np.testing.assert_array_equal(field.steps[1, 2], [0, 0])
    across, down = crosshair(field)
    np.testing.assert_allclose(across.steps, [2, 1, 0, -1.4, -2], rtol=1e-6)
    np.testing.assert_allclose(down.steps, [1.5, 0, -1.5], rtol=1e-6)
    assert (field.farthest, _random().farthest) == (2, 2)
    assert _random(positions=_places(rows=(-2.2, 0, 1.5))).farthest == 3
    with pytest.raises(TypeError, match="`light_field.positions` is traced"):
        jax.jit(lambda s: jnp.asarray(s.farthest))(field)


def test_positions_survive_what_is_done_to_a_light_field():
    field = _random(positions=_places())
    others = (field.bare(), field.without_truth(), field.renamed("another"), field.downsample(2))
    for same in (*others, field.without_views([(0, 0)]), jax.jit(lambda s: s)(field)):
        np.testing.assert_array_equal(same.positions, field.positions)
    cropped = field.crop_views(3, 1).positions
    np.testing.assert_array_equal(cropped, np.asarray(field.positions)[:, 2:3])
    assert _random().bare().positions is None


_BENT = _places() + 0.3 * (np.arange(5) == 4)[None, :, None] * [0, 1]


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        (_places() * np.nan, r"must be finite, .*got \[nan nan\] .*\(v, u\) = \(0, 0\)"),
        (_places() + 1, r"must be \(0, 0\) for the center view, .*\(1, 2\), got \[1. 1.\]"),
        (_places()[:, ::-1] * [1, 1], r"columns that increase to the right, got 2 .* and 1.4"),
        (_places() * [1, -1], r"rows that increase down, got 1.5 .* and -0 for \(1, 0\)"),
        (_places((-1350, -1, 0, 1, 2)), r"within 1000 view steps .* got \[-1350. +-1.5\] for"),
        (60 * _places(), r"in view steps, .* columns about 1 apart \(0.1 to 10\), got 60"),
        (_places()[:2], r"of shape \(3, 5, 2\), got \(2, 5, 2\)"),
        (_BENT, r"center row on a straight row, at most 0.25 .* got 0.3 .*\(v, u\) = \(1, 4\)"),
    ],
)
def test_positions_are_those_of_rows_and_columns(positions, message):
    with pytest.raises(ValueError, match=message):
        _random(positions=positions)


def test_a_plane_moves_as_the_convention_says():
    x = np.arange(32.0)
    rows = [np.sin(0.3 * (x - (2 - u) * 1.5)) * 0.5 + 0.5 for u in range(5)]
    views = np.broadcast_to(np.stack(rows)[None, :, None, :, None], (3, 5, 4, 32, 3))
    field = LightField(views)
    du = field.steps[1, 0, 0]
    there = np.interp(x[8:20] + float(du) * 1.5, x, np.asarray(field.views[1, 0, 0, :, 0]))
    np.testing.assert_allclose(there, field.center_view[0, 8:20, 0], atol=0.02)
