"""The dense measurement in two arms and in all views: right, honest, blind to what is missing."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, check_modes, with_values
from photometry.planes import error, look, measured, plane_arms, plane_views, splines_of
from scipy import ndimage

from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry.measuring import (
    AdaptedMeasurement,
    CrosshairSplines,
    NormalEquations,
    PhotometricLabels,
    ViewSplines,
    labels,
    residual_variance,
)
from mvedge_jax.photometry.measuring._measure import average_over_surface
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


@KINDS
def test_a_missing_view_takes_no_part(kind):
    views, start = splines_of(plane_views(0.2), kind), jnp.full(SHAPE, 0.15)
    gone = 0 if kind == "crosshair" else 3  # the first of all views is the reference
    arm = views.horizontal if kind == "crosshair" else views
    own = arm.others if kind == "crosshair" else arm.splines

    def holding(planes):
        there = arm.available.at[gone].set(False)
        if kind == "crosshair":
            return views._replace(horizontal=arm._replace(others=planes, available=there))
        return views._replace(splines=planes, available=there)

    def disparity(planes):
        return measured(holding(planes), start, passes=1).disparity

    junk = own.at[gone].set(0.123)
    np.testing.assert_array_equal(disparity(own), disparity(junk))
    gradient = jax.grad(lambda p: disparity(p).sum())(own)
    assert float(jnp.abs(gradient[gone]).max()) == 0
    assert float(jnp.abs(gradient[1]).max()) > 0


@KINDS
def test_flat_images_leave_the_map_alone_and_say_so(kind):
    flat = splines_of(LightField(jnp.full((5, 5, *SHAPE, 3), 0.5)), kind)
    found = measured(flat, jnp.full(SHAPE, 0.4))
    np.testing.assert_allclose(found.disparity, 0.4, atol=1e-9)
    assert float(found.variance.min()) > 1


@KINDS
def test_a_drift_of_colours_is_not_taken_for_parallax(kind):
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


def test_matt_surfaces_pay_nothing_for_drift():
    # Noise without drift: to believe every drift costs information, to ask for evidence none.
    truth, start = 0.31, jnp.full((40, 48), 0.31)
    views, inner = splines(truth, size=(40, 48), noise=0.01), (slice(8, -8), slice(8, -8))

    def off(**settings):
        found = measured(views, start, with_values(AdaptedMeasurement, **settings), passes=1)
        return error(found, truth, inner)

    rigid, asked, believed = off(stiffness=1e9), off(), off(drift=0.0)
    assert believed > 1.05 * rigid
    assert asked - rigid < 0.3 * (believed - rigid)


def test_a_small_step_parts_surfaces_only_where_disparities_are_known():
    params = AdaptedMeasurement()
    step = jnp.where(jnp.arange(28) < 14, 0, 2.5 * params.same_surface)
    disparity = jnp.broadcast_to(0.3 + step, SHAPE)
    around = look(splines(0.3), disparity, radius=1)
    spike = jnp.zeros(SHAPE).at[10, 14].set(1.0)

    def across(information):
        known = jnp.full(SHAPE, information)
        found = around._replace(power=spike, freedom=jnp.ones(SHAPE), information=known)
        shares = residual_variance(found, PLAIN, disparity, params, passes=1)
        return float(shares[10, 13] / shares[10, 15])

    assert across(1e6) < 0.01
    assert across(0.0) > 0.5


@pytest.mark.parametrize("variance", [1e-6, 1.0])
def test_labels_are_shared_across_small_steps_only_however_little_is_known(variance):
    params = AdaptedMeasurement()

    def beside(step):
        disparity = jnp.broadcast_to(0.3 + jnp.where(jnp.arange(28) < 14, 0, step), SHAPE)
        known = jnp.full_like(disparity, variance)
        found = PhotometricLabels(disparity, known, jnp.zeros_like(disparity))
        averaged = average_over_surface(found, PLAIN, params, passes=2).disparity
        return float(averaged[10, 13] - 0.3) / step

    assert beside(params.same_surface) > 0.2
    assert beside(12 * params.same_surface) < 0.01


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
        colours = np.moveaxis(view, -1, 0)
        return [ndimage.map_coordinates(c, place, order=3, mode="mirror") for c in colours]

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
        np.testing.assert_allclose(changed[y, x], regressed(field, 0.26, y, x, 2.0), rtol=1e-3)


@pytest.mark.parametrize("nearer", [1.0, 2.0])
def test_views_in_which_a_pixel_is_hidden_do_not_count(nearer):
    """Oracle: every pixel of the map is taken to where it lands in every view."""
    shape = (20, 24)
    disparity = np.zeros(shape)
    disparity[8:12, 9:14] = nearer
    field = plane_views(0.0, size=shape)
    found = look(splines_of(field, "all"), jnp.asarray(disparity), PURE, radius=8)
    visible = np.zeros(shape)
    for step in np.asarray(field.steps).reshape(-1, 2):
        y, x = (np.mgrid[:20, :24] + step[::-1, None, None] * disparity).astype(int)
        front = np.full((40, 44), -np.inf)
        np.maximum.at(front, (10 + y, 10 + x), disparity)
        inside = (y >= 0) & (y < 20) & (x >= 0) & (x < 24)
        visible += inside & (front[10 + y, 10 + x] == disparity)
    count = np.asarray(found.freedom) + 1
    # A thin occluder may uncover a pixel again: what is hidden, is; what counts, is visible.
    assert (count <= visible + 1e-6).mean() > 0.97
    assert np.abs(count - visible).mean() < 1.0


def test_a_grid_of_one_row_is_an_arm():
    views = splines_of(plane_views(0.3, views=(1, 5), size=(14, 17)), "all")
    start = jnp.full((14, 17), 0.28)
    found = measured(views, start, PURE).disparity
    assert float(jnp.abs(found - 0.3)[4:-4, 4:-4].max()) < 0.01
    np.testing.assert_array_equal(look(views, start, PURE).spread[1], 0)


def test_noise_is_no_information():
    # Plain surfaces under noise: what looks like contrast must not pass for a measurement.
    rng = np.random.default_rng(2)
    grain = plane_arms(0.2).mapped(lambda p: jnp.asarray(0.5 + 0.02 * rng.standard_normal(p.shape)))
    params = with_values(AdaptedMeasurement, noise=0.02)
    textured, nothing = (
        np.median(1 / (1 + measured(v, jnp.full(SHAPE, 0.2), params).variance[4:-4, 4:-4] / 1e-4))
        for v in (splines(0.2, noise=0.02, seed=1), CrosshairSplines.of(grain))
    )
    assert nothing < 0.02 * textured


def test_neighbours_of_another_colour_take_no_part():
    views, start = splines(0.2), jnp.full(SHAPE, 0.18)
    lab = PLAIN.at[0, :, 14:].set(60.0)

    def total(planes):
        arm = views.horizontal._replace(centre=planes[0], others=planes[1])
        found = measured(views._replace(horizontal=arm), start, lab=lab)
        # The half that is looked at is far from what the other half's occlusions could reach.
        return jnp.sum(found.disparity[:, :12] ** 2)

    centre, others = jax.grad(total)((views.horizontal.centre, views.horizontal.others))
    gradient = jnp.concatenate([centre[None], others])
    # Nine columns of the spline, its view steps and the trust in views reach over the outline.
    assert float(jnp.abs(gradient[..., 17:]).max()) < 1e-12 * float(jnp.abs(gradient).max())


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
            own = views._replace(horizontal=arm._replace(centre=planes[0], others=planes[1]))
        else:
            own = ViewSplines.of(made._replace(planes=planes))
        around = own.accumulate(disparity, replace(params, radius=2))
        found = labels(around, lab, disparity, params, passes=1)
        residual = residual_variance(around, lab, disparity, params, passes=1)
        sure = jnp.sum(1 / (1 + 1e4 * found.variance))
        return jnp.sum(found.disparity**2) + sure + jnp.sum(jnp.sqrt(residual + 1e-6))

    planes = (arm.centre, arm.others) if kind == "crosshair" else made.planes
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
    np.testing.assert_allclose(
        exact, jax.jit(lambda v, s: measured(v, s).disparity)(views, start), atol=1e-12
    )
    single = jax.tree.map(lambda a: a if a.dtype == bool else a.astype(jnp.float32), views)
    found = measured(single, start.astype(jnp.float32)).disparity
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, exact, atol=1e-4)
