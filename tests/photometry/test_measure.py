"""The dense measurement: right, honest about its errors, blind to what is missing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, random_like, with_values
from photometry.planes import accumulate, photometric_labels, plane_arms, plane_splines

from mvedge_jax.photometry.measuring import (
    AdaptedMeasurement,
    CrosshairSplines,
    NormalEquations,
    PhotometricLabels,
    labels,
    residual_variance,
)
from mvedge_jax.photometry.measuring._measure import average_over_surface

# Of one colour, so that no neighbour is left out for its own.
PLAIN = jnp.zeros((3, 20, 28))


def test_a_photometric_step_finds_the_plane_and_knows_how_well():
    truth, start = 0.31, 0.28
    errors, predicted = [], []
    for seed in range(3):
        arms = plane_splines(truth, noise=0.01, seed=seed)
        labels = photometric_labels(
            arms[0],
            arms[1],
            PLAIN,
            jnp.full((20, 28), start),
            # These views sample a spline: what pixels do to an outline is not in them.
            with_values(AdaptedMeasurement, noise=0.01, error_floor=0.0),
            radius=2,
            passes=2,
        )
        inner = (slice(4, -4), slice(4, -4))
        errors.append((np.asarray(labels.disparity) - truth)[inner])
        predicted.append(np.sqrt(np.asarray(labels.variance))[inner])
    error = np.sqrt(np.mean(np.square(errors)))
    assert error < 0.25 * (truth - start)
    assert 0.5 < error / np.sqrt(np.mean(np.square(predicted))) < 2


def test_missing_views_take_no_part():
    across, down = plane_splines(0.2)
    there = across.available.at[0].set(False)
    params = AdaptedMeasurement()
    disparity = jnp.full((20, 28), 0.15)

    def measure(planes):
        arm = across._replace(others=planes, available=there)
        return photometric_labels(arm, down, PLAIN, disparity, params, radius=2, passes=1).disparity

    junk = across.others.at[0].set(0.123)
    np.testing.assert_array_equal(measure(across.others), measure(junk))
    gradient = jax.grad(lambda p: measure(p).sum())(across.others)
    assert float(jnp.abs(gradient[0]).max()) == 0
    assert float(jnp.abs(gradient[1]).max()) > 0


def test_flat_images_leave_the_map_alone_and_say_so():
    arms = plane_splines(0.0)
    flat = tuple(
        a._replace(centre=jnp.full_like(a.centre, 0.5), others=jnp.full_like(a.others, 0.5))
        for a in arms
    )
    labels = photometric_labels(
        flat[0], flat[1], PLAIN, jnp.full((20, 28), 0.4), AdaptedMeasurement(), radius=2, passes=2
    )
    np.testing.assert_allclose(labels.disparity, 0.4, atol=1e-9)
    assert float(labels.variance.min()) > 1


def test_a_small_step_parts_surfaces_only_where_disparities_are_known():
    arms, params = plane_splines(0.3), AdaptedMeasurement()
    step = jnp.where(jnp.arange(28) < 14, 0, 2.5 * params.same_surface)
    disparity = jnp.broadcast_to(0.3 + step, (20, 28))
    around = accumulate(*arms, disparity, params, radius=1)
    spike = jnp.zeros((20, 28)).at[10, 14].set(1.0)

    def across(information):
        known = jnp.full((20, 28), information)
        found = around._replace(power=spike, freedom=jnp.ones((20, 28)), information=known)
        shares = residual_variance(found, PLAIN, disparity, params, passes=1)
        return float(shares[10, 13] / shares[10, 15])

    assert across(1e6) < 0.01
    assert across(0.0) > 0.5


@pytest.mark.parametrize("variance", [1e-6, 1.0])
def test_labels_are_shared_across_small_steps_only_however_little_is_known(variance):
    params = AdaptedMeasurement()

    def beside(step):
        disparity = jnp.broadcast_to(0.3 + jnp.where(jnp.arange(28) < 14, 0, step), (20, 28))
        known = jnp.full_like(disparity, variance)
        measured = PhotometricLabels(disparity, known, jnp.zeros_like(disparity))
        averaged = average_over_surface(measured, PLAIN, params, passes=2).disparity
        return float(averaged[10, 13] - 0.3) / step

    assert beside(params.same_surface) > 0.2
    assert beside(12 * params.same_surface) < 0.01


def small_problem():
    """What the measurement reads, and a smooth number that all of its results go into."""
    across, down = plane_splines(0.2, views=(3, 3), size=(8, 9))
    rng = np.random.default_rng(0)
    disparity = 0.15 + 0.01 * jnp.sin(jnp.arange(72.0).reshape(8, 9))
    lab = jnp.asarray(8 * rng.standard_normal((3, 8, 9)))

    def loss(tree):
        (centre, others), lab, disparity, params = tree
        arm = across._replace(centre=centre, others=others)
        around = accumulate(arm, down, disparity, params, radius=2)
        found = labels(around, lab, disparity, params, passes=1)
        residual = residual_variance(around, lab, disparity, params, passes=1)
        sure = jnp.sum(1 / (1 + 1e4 * found.variance))
        return jnp.sum(found.disparity**2) + sure + jnp.sum(jnp.sqrt(residual + 1e-6))

    return loss, ((across.centre, across.others), lab, disparity, AdaptedMeasurement())


def test_gradient_of_the_measurement_matches_differences():
    loss, tree = small_problem()
    # Short steps: a longer one crosses kinks of the floors.
    check_gradient(loss, tree, rtol=1e-5, step=1e-7, key=jax.random.key(1))


@pytest.mark.slow
def test_forward_mode_of_the_measurement_agrees():
    loss, tree = small_problem()
    direction = random_like(tree, key=jax.random.key(2))
    _, tangent = jax.jit(lambda t, d: jax.jvp(loss, (t,), (d,)))(tree, direction)
    gradient = jax.tree.leaves(jax.jit(jax.grad(loss))(tree))
    pairs = zip(gradient, jax.tree.leaves(direction), strict=True)
    assert float(tangent) == pytest.approx(sum(float(jnp.vdot(a, b)) for a, b in pairs))


def drifting(arms, drift):
    """Views whose colours change by `drift`, one number per channel, from each to the next."""
    change = jnp.asarray(drift)[None, :, None, None]
    moved = (a._replace(others=a.others + a.steps[:, None, None, None] * change) for a in arms)
    return CrosshairSplines(*moved)


def test_drift_does_not_move_a_label():
    # Gloss: every view is a little brighter than the one before it, in a colour of its own.
    truth = 0.31
    arms = drifting(plane_splines(truth), (0.012, 0.006, -0.004))
    inner = (slice(4, -4), slice(4, -4))
    errors = []
    for stiffness in (1.0, 1e9):
        params = with_values(AdaptedMeasurement, stiffness=stiffness)
        labels = photometric_labels(
            *arms, PLAIN, jnp.full((20, 28), truth), params, radius=2, passes=2
        )
        errors.append(float(jnp.sqrt(jnp.mean((labels.disparity - truth)[inner] ** 2))))
    with_drift, without = errors
    assert with_drift < 0.1 * without
    assert with_drift < 2e-3


def test_matt_surfaces_pay_nothing_for_drift():
    # Noise without drift: to believe every drift costs information, to ask for evidence none.
    truth = 0.31
    arms = plane_splines(truth, size=(40, 48), noise=0.01)
    inner = (slice(8, -8), slice(8, -8))

    def error(**settings):
        params = with_values(AdaptedMeasurement, **settings)
        start, plain = jnp.full((40, 48), truth), jnp.zeros((3, 40, 48))
        labels = photometric_labels(*arms, plain, start, params, radius=2, passes=1)
        return float(jnp.sqrt(jnp.mean((labels.disparity - truth)[inner] ** 2)))

    rigid, asked, believed = error(stiffness=1e9), error(), error(drift=0.0)
    assert believed > 1.05 * rigid
    assert asked - rigid < 0.3 * (believed - rigid)


def test_elimination_equals_the_regression_with_all_unknowns():
    # One window over everything: the normal equations in the disparity and six drifts, in NumPy.
    rng = np.random.default_rng(5)
    shape = (3, 3)
    fields = [rng.uniform(1, 2, (*shape, 2)), rng.standard_normal((2, 2, 3, *shape))]
    spread = fields[0]
    slope, trend = fields[1] * np.moveaxis(spread, -1, 0)[None, :, None]
    gradient = slope / np.moveaxis(spread, -1, 0)[:, None]
    right = -(gradient * trend).sum((0, 1))
    information = (gradient * slope).sum((0, 1))
    # Enough power for a residual, whatever the drifts explain.
    power = (trend**2).sum((0, 1)) * 10 + 1
    freedom = np.full(shape, 10.0)

    def per_arm(field):
        across, down = jax.tree.map(jnp.asarray, [tuple(arm) for arm in field])
        return across, down

    found = NormalEquations(
        right=jnp.asarray(right),
        information=jnp.asarray(information),
        power=jnp.asarray(power),
        freedom=jnp.asarray(freedom),
        views=jnp.asarray(9.0),
        cross=None,
        spread=(jnp.asarray(spread[..., 0]), jnp.asarray(spread[..., 1])),
        slope=per_arm(slope),
        trend=per_arm(trend),
    )
    exact = {"drift": 0.0, "error_floor": 0.0, "gradient_noise": 0.0}
    params = with_values(AdaptedMeasurement, **exact, largest_step=1e6, stiffness=2.0)
    labels_ = labels(found, jnp.zeros((3, *shape)), jnp.zeros(shape), params, passes=1)
    taps = np.outer([0.5, 1, 0.5], [0.5, 1, 0.5])

    def window(field):
        return (taps * field).sum((-2, -1))

    # Unknowns: error of the disparity, then a drift per arm and channel; (r + k (g e - h))².
    matrix, vector = np.zeros((7, 7)), np.zeros(7)
    matrix[0, 0], vector[0] = window(information), window(right)
    for i, (a, c) in enumerate(np.ndindex(2, 3), start=1):
        matrix[0, i] = matrix[i, 0] = -window(slope[a, c])
        matrix[i, i] = window(spread[..., a]) + 2.0
        vector[i] = window(trend[a, c])
    solution = np.linalg.solve(matrix, vector)
    assert float(labels_.disparity[1, 1]) == pytest.approx(solution[0], rel=1e-6)
    rest = window(power) - solution @ vector
    variance = rest / (3 * window(freedom)) * np.linalg.inv(matrix)[0, 0]
    assert float(labels_.variance[1, 1]) == pytest.approx(variance, rel=1e-6)


def test_noise_is_no_information():
    # Plain surfaces under noise: what looks like contrast must not pass for a measurement.
    truth = 0.2
    noisy = plane_splines(truth, noise=0.02, seed=1)
    rng = np.random.default_rng(2)
    plain = CrosshairSplines.of(
        plane_arms(truth).mapped(lambda p: jnp.asarray(0.5 + 0.02 * rng.standard_normal(p.shape)))
    )
    disparity = jnp.full((20, 28), truth)
    weights = []
    for arms in (noisy, plain):
        found = photometric_labels(
            *arms, PLAIN, disparity, with_values(AdaptedMeasurement, noise=0.02), radius=2, passes=2
        )
        weights.append(np.median(1 / (1 + np.asarray(found.variance)[4:-4, 4:-4] / 0.01**2)))
    textured, nothing = weights
    assert nothing < 0.02 * textured


def test_neighbours_of_another_colour_take_no_part():
    across, down = plane_splines(0.2)
    disparity = jnp.full((20, 28), 0.18)
    lab = PLAIN.at[0, :, 14:].set(60.0)

    def measured(planes):
        arm = across._replace(centre=planes[0], others=planes[1])
        params = AdaptedMeasurement()
        # The half that is looked at is far from what the other half's occlusions could reach.
        return photometric_labels(arm, down, lab, disparity, params, radius=2, passes=2).disparity[
            :, :12
        ]

    gradients = jax.grad(lambda p: jnp.sum(measured(p) ** 2))((across.centre, across.others))
    gradient = jnp.concatenate([gradients[0][None], gradients[1]])
    # Nine columns of the spline, its view steps and the trust in views reach over the outline.
    assert float(jnp.abs(gradient[..., 17:]).max()) < 1e-12 * float(jnp.abs(gradient).max())
