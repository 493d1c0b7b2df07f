"""The dense measurement in two arms and in all views: right, honest, blind to what is missing."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from edges.scenes import plane, two_planes
from helpers import check_gradient, check_modes, with_values
from numpy.testing import assert_allclose, assert_array_equal
from photometry.scenes import error, measured, plane_views, splines_of, textured
from scipy import ndimage

from mvedge_jax._crosshair import crosshair
from mvedge_jax._params import cast
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import first_labels, prepare, prepare_views
from mvedge_jax.photometry._window import color_weights, contrast, weighted_sum
from mvedge_jax.photometry.brightness import GridViews
from mvedge_jax.photometry.matching import Matching
from mvedge_jax.photometry.measuring import (
    AdaptedMeasurement,
    CrosshairSplines,
    Measurement,
    NormalEquations,
    ViewSplines,
    labels,
    residual_variance,
)
from mvedge_jax.photometry.views import views_of

SHAPE = (20, 28)
PLAIN = jnp.zeros((3, *SHAPE))
KINDS = pytest.mark.parametrize("kind", ["crosshair", "all"])
# Nothing is an outlier, nothing is noise, and steps are not limited.
EXACT = {"drift": 0.0, "gradient_noise": 0.0, "largest_step": 1e6, "stiffness": 2.0}


def splines(truth, **choices):
    return splines_of(plane_views(truth, **choices))


def test_a_plane_is_found_and_known_how_well_and_better_in_all_views():
    truth, start = 0.31, jnp.full(SHAPE, 0.28)
    # These views sample a spline: what pixels do to an outline is not in them.
    params = with_values(AdaptedMeasurement, noise=0.01, error_floor=0.0)
    errors, deviations = [], []
    for seed in range(3):
        field = plane_views(truth, noise=0.01, seed=seed)
        found = [measured(splines_of(field, kind), start, params) for kind in ("crosshair", "all")]
        errors.append([error(each, truth) for each in found])
        deviations.append([float(jnp.mean(each.variance[4:-4, 4:-4])) for each in found])
    arms, every = np.sqrt(np.mean(np.square(errors), 0))
    said, less = np.sqrt(np.mean(deviations, 0))
    assert arms < 0.25 * 0.03
    assert 0.5 < arms / said < 2
    assert every < 0.8 * arms
    assert less < said


def test_a_window_far_to_the_right_has_the_sums_of_the_image():
    field = textured(views=3, size=(8, 2100))
    params = with_values(AdaptedMeasurement)
    arms, disparity = crosshair(field), jnp.full((8, 2100), 0.37, jnp.float32)
    whole = CrosshairSplines.of(arms).accumulate(disparity, params)
    part = crosshair(replace(field, views=field.views[:, :, :, 2000:]))
    part = CrosshairSplines.of(part).accumulate(disparity[:, 2000:], params)
    # Filters of the views end within 20 px of the border of the window.
    assert_array_equal(whole.right[:, 2020:], part.right[:, 20:])
    assert_array_equal(whole.information[:, 2020:], part.information[:, 20:])


@KINDS
def test_a_missing_view_takes_no_part(kind):
    views, start = splines_of(plane_views(0.2), kind), jnp.full(SHAPE, 0.15)
    # The first of all views is the reference.
    gone, arm, name = (
        (0, views.horizontal, "others") if kind == "crosshair" else (3, views, "splines")
    )
    own = getattr(arm, name)

    def disparity(planes):
        held = arm._replace(**{name: planes}, available=arm.available.at[gone].set(False))
        held = views._replace(horizontal=held) if kind == "crosshair" else held
        return measured(held, start, passes=1).disparity

    assert_array_equal(disparity(own), disparity(own.at[gone].set(0.123)))
    gradient = jax.grad(lambda p: disparity(p).sum())(own)
    assert float(jnp.abs(gradient[gone]).max()) == 0
    assert float(jnp.abs(gradient[1]).max()) > 0


@KINDS
def test_a_drift_of_colors_is_not_taken_for_parallax(kind):
    """Gloss: oracle is the true disparity. Without the drift in the model it is missed by far."""
    truth, field = 0.31, plane_views(0.31)
    steps = np.asarray(field.steps) @ [1.0, 1.0 if kind == "crosshair" else 0.5]
    change = steps[:, :, None, None, None] * np.array([0.012, 0.006, -0.004])
    moved = np.clip(np.asarray(field.views) + change, 0, 1)
    views = splines_of(LightField(jnp.asarray(moved)), kind)
    with_drift, without = (
        error(
            measured(views, jnp.full(SHAPE, truth), with_values(AdaptedMeasurement, stiffness=s)),
            truth,
        )
        for s in (1.0, 1e9)
    )
    assert with_drift < (0.1 if kind == "crosshair" else 0.2) * without
    assert with_drift < 2e-3


def test_elimination_equals_the_regression_with_all_unknowns():
    """One window over everything: normal equations in the disparity and six drifts, in NumPy."""
    rng, shape = np.random.default_rng(5), (3, 3)
    spread = rng.uniform(1, 2, (2, *shape))
    slope, trend = rng.standard_normal((2, 2, 3, *shape)) * spread[None, :, None]
    gradient = slope / spread[:, None]
    # Enough power for a residual, whatever the drifts explain.
    given = {
        "right": -(gradient * trend).sum((0, 1)),
        "information": (gradient * slope).sum((0, 1)),
        "power": (trend**2).sum((0, 1)) * 10 + 1,
        "freedom": np.full(shape, 10.0),
        "views": np.asarray(9.0),
    }
    per_arm = [tuple(tuple(arm) for arm in field) for field in (slope, trend)]
    slopes, trends, spreads = jax.tree.map(jnp.asarray, (*per_arm, tuple(spread)))
    arrays = {name: jnp.asarray(value) for name, value in given.items()}
    found = NormalEquations(**arrays, cross=None, spread=spreads, slope=slopes, trend=trends)
    params = with_values(AdaptedMeasurement, **EXACT, error_floor=0.0)
    label = labels(found, jnp.zeros((3, *shape)), jnp.zeros(shape), params, passes=1)
    taps = np.outer([0.5, 1, 0.5], [0.5, 1, 0.5])

    def window(field):
        return (taps * field).sum((-2, -1))

    # Unknowns: error of the disparity, then a drift per arm and channel; (r + k (g e - h))².
    matrix, vector = np.zeros((7, 7)), np.zeros(7)
    matrix[0, 0], vector[0] = window(given["information"]), window(given["right"])
    for i, (a, c) in enumerate(np.ndindex(2, 3), start=1):
        matrix[0, i] = matrix[i, 0] = -window(slope[a, c])
        matrix[i, i] = window(spread[a]) + 2.0
        vector[i] = window(trend[a, c])
    solution = np.linalg.solve(matrix, vector)
    assert float(label.disparity[1, 1]) == pytest.approx(solution[0], rel=1e-6)
    rest = window(given["power"]) - solution @ vector
    variance = rest / (3 * window(given["freedom"])) * np.linalg.inv(matrix)[0, 0]
    assert float(label.variance[1, 1]) == pytest.approx(variance, rel=1e-6)


def regressed(field, disparity, y, x, stiffness):
    """The error of the disparity at a pixel, all unknowns solved for together, in NumPy."""
    views, steps = np.asarray(field.views), np.asarray(field.steps)
    tiny = 1e-5
    around = np.array([[0, 0], [0, tiny], [0, -tiny], [tiny, 0], [-tiny, 0]])

    def seen(view, step):
        place = (np.array([y, x]) + step[::-1] * disparity + around).T
        colors = np.moveaxis(view, -1, 0)
        return [ndimage.map_coordinates(c, place, order=3, mode="mirror") for c in colors]

    own, right, left, below, above = np.stack(
        [np.stack(seen(views[at], steps[at]), -1) for at in np.ndindex(views.shape[:2])], axis=1
    )
    g = np.stack([right - left, below - above]).mean(1) / (2 * tiny)
    k = steps.reshape(-1, 2) - steps.mean((0, 1))
    # An error of the disparity, and a drift per channel and axis, which a prior holds at 0.
    rows = [np.column_stack([k @ g[:, c], np.kron(np.eye(3)[c], -k)]) for c in range(3)]
    prior = np.column_stack([np.zeros(6), np.sqrt(stiffness) * np.eye(6)])
    known = np.concatenate([(own.mean(0) - own).T.ravel(), np.zeros(6)])
    return np.linalg.lstsq(np.concatenate([*rows, prior]), known, rcond=None)[0][0]


PURE = with_values(AdaptedMeasurement, **EXACT, outlier=1e12, noise=1.0)


def test_all_views_give_what_a_regression_with_all_unknowns_does():
    field, start = plane_views(0.3, views=(3, 5), size=(14, 17)), jnp.full((14, 17), 0.26)
    changed = measured(splines_of(field, "all"), start, PURE, passes=0).disparity - start
    for y, x in ((5, 6), (8, 9), (6, 10)):
        assert_allclose(changed[y, x], regressed(field, 0.26, y, x, 2.0), rtol=1e-3)


def problem(kind):
    """What the measurement reads, and a smooth number that all of its results go into."""
    field, rng = plane_views(0.2, views=(3, 3), size=(8, 9)), np.random.default_rng(0)
    disparity = 0.15 + 0.01 * jnp.sin(jnp.arange(72.0).reshape(8, 9))
    lab = jnp.asarray(8 * rng.standard_normal((3, 8, 9)))
    views, made = splines_of(field), views_of(field)
    arm = views.horizontal

    def loss(tree):
        planes, lab, disparity, params = tree
        if kind == "crosshair":
            own = views._replace(horizontal=arm._replace(center=planes[0], others=planes[1]))
        else:
            own = ViewSplines.of(made._replace(planes=planes))
        around = own.accumulate(disparity, replace(params, radius=2))
        found = labels(around, lab, disparity, params, passes=1)
        residual = residual_variance(around, lab, disparity, params, passes=1)
        sure = jnp.sum(1 / (1 + 1e4 * found.variance))
        return jnp.sum(found.disparity**2) + sure + jnp.sum(jnp.sqrt(residual + 1e-6))

    planes = (arm.center, arm.others) if kind == "crosshair" else made.planes
    return loss, (planes, lab, disparity, AdaptedMeasurement())


def test_gradient_of_the_measurement_matches_differences():
    loss, tree = problem("crosshair")
    # Short steps: a longer one crosses kinks of the floors.
    check_gradient(loss, tree, rtol=1e-5, step=1e-7, key=jax.random.key(1))


@pytest.mark.slow
@KINDS
def test_derivatives_of_the_measurement_in_every_mode(kind):
    loss, tree = problem(kind)
    check_modes(loss, tree, rtol=1e-4, step=1e-6, key=jax.random.key(2))


def test_jit_and_single_precision_change_little():
    views, start = splines_of(plane_views(0.3, size=(14, 17)), "all"), jnp.full((14, 17), 0.28)
    exact = measured(views, start).disparity
    assert_allclose(exact, jax.jit(lambda v, s: measured(v, s).disparity)(views, start), atol=1e-12)
    single = jax.tree.map(lambda a: a if a.dtype == bool else a.astype(jnp.float32), views)
    found = measured(single, start.astype(jnp.float32)).disparity
    assert found.dtype == jnp.float32
    assert_allclose(found, exact, atol=1e-4)


def test_a_scene_without_a_first_map_or_arms_is_told():
    views = views_of(plane(0.37))

    def refused(light_field):
        tried = jnp.linspace(0, 0.7, 5).astype(light_field.views.dtype)
        scene = prepare(GridViews(light_field), tried, cast(Matching(), tried.dtype), window=2)
        seen = prepare_views(scene, cast(Measurement(radius=3), tried.dtype))
        with pytest.raises(ValueError, match="`scene` has no first map; `prepare` finds one"):
            first_labels(scene._replace(hypotheses=None), seen)
        with pytest.raises(ValueError, match="`prepared` must be views of a crosshair, got photo"):
            first_labels(scene, seen._replace(splines=ViewSplines.of(views)))
        with pytest.raises(TypeError, match="`views` must be a crosshair to have arms, got photo"):
            _ = scene._replace(views=views).arms
        return seen.params

    jax.eval_shape(refused, plane(0.37))  # before anything is compiled


def test_views_that_a_nearer_surface_hides_or_that_differ_weigh_little():
    light_field, params = (
        two_planes(0.8, -0.6, edge=30.2),
        cast(AdaptedMeasurement(radius=12), jnp.float32),
    )
    truth = jnp.where(jnp.arange(64) < 30, 0.8, -0.6)[None] * jnp.ones((16, 1))

    def weights(views):
        splines = CrosshairSplines.of(crosshair(LightField(views)))
        return np.asarray(splines.accumulate_with_weights(truth.astype(jnp.float32), params)[1])

    found = weights(light_field.views)
    assert found.shape == (18, 16, 64)
    # Right of the border, the near plane comes over the pixel in views of one side only.
    across = found[9:, 4:12, 33].mean(1)
    hidden, shown = (across[:2], across[6:]) if across[0] < across[-1] else (across[7:], across[:3])
    assert hidden.max() == 0
    assert shown.min() > 0.3
    painted = weights(light_field.views.at[4, 0].set(0.9))[9:, 4:12, 10:24].mean((1, 2))
    assert painted[0] < 0.3
    assert painted[1:].min() > 0.5


@pytest.mark.parametrize("spacing", [1, 2])
def test_mean_over_neighbors_of_like_color(spacing):
    rng = np.random.default_rng(spacing)
    image, lab = rng.standard_normal((9, 11)), 5 * rng.standard_normal((3, 9, 11))
    weights = color_weights(jnp.asarray(lab), jnp.asarray(4.0), reach=1, spacing=spacing)
    found = weighted_sum(jnp.asarray(image)[None], weights, spacing=spacing)[0]
    for y, x in np.ndindex(9, 11):
        total = sums = 0.0
        for dy, dx in np.ndindex(3, 3):
            other = (np.clip(y + (dy - 1) * spacing, 0, 8), np.clip(x + (dx - 1) * spacing, 0, 10))
            weight = np.exp(-np.linalg.norm(lab[:, *other] - lab[:, y, x]) / 4)
            total, sums = total + weight, sums + weight * image[other]
        assert float(found[y, x]) == pytest.approx(sums / total)


@pytest.mark.parametrize("radius", [0, 3])
def test_contrast_is_the_largest_gradient_nearby(radius):
    lab = np.random.default_rng(radius).standard_normal((3, 14, 17))
    taps = np.array([1, 4, 6, 4, 1]) / 16
    square = 0.0
    for channel in lab:
        for axis in (0, 1):
            channel = ndimage.correlate1d(channel, taps, axis=axis, mode="nearest")
        for axis in (0, 1):
            slope = ndimage.correlate1d(channel, [-0.5, 0, 0.5], axis=axis, mode="nearest")
            square = square + slope**2
    expected = ndimage.maximum_filter(np.sqrt(square), 2 * radius + 1, mode="nearest")
    assert_allclose(contrast(jnp.asarray(lab), radius=radius), expected, atol=1e-12)


@pytest.mark.parametrize("mode", ["edge", "constant"])
def test_derivatives_in_both_modes_which_are_finite_where_all_is_equal(mode):
    key = jax.random.split(jax.random.key(1))
    lab, images = 9 * jax.random.normal(key[0], (3, 6, 7)), jax.random.normal(key[1], (2, 6, 7))

    def loss(tree):
        lab, images = tree
        weights = color_weights(lab, jnp.asarray(4.0), reach=1)
        found = weighted_sum(images, weights, spacing=2, mode=mode)
        return jnp.sum(jnp.sin(found)) + jnp.sum(contrast(lab, radius=2))

    check_modes(loss, (lab, images), rtol=1e-6, key=key[0])
    flat = jax.grad(loss)((jnp.ones_like(lab), images))
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in flat)
