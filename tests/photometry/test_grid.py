"""All views read around a map: against brute force, and against the crosshair."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_modes, with_values
from photometry.planes import photometric_labels, plane_views
from scipy import ndimage

from mvedge_jax._crosshair import crosshair
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry.measuring import (
    AdaptedMeasurement,
    CrosshairSplines,
    ViewSplines,
    labels,
)
from mvedge_jax.photometry.views import views_of

SHAPE = (14, 17)
LAB = jnp.zeros((3, *SHAPE))
# Nothing is an outlier, nothing is noise, and steps are not limited.
PLAIN = with_values(
    AdaptedMeasurement,
    outlier=1e12,
    gradient_noise=0.0,
    largest_step=1e6,
    stiffness=2.0,
    drift=0.0,
    noise=1.0,
)


def grid(field):
    return ViewSplines.of(views_of(field))


def accumulate_around(views, disparity, params, *, radius):
    return views.accumulate(disparity, replace(params, radius=radius))


def regressed(field, disparity, y, x, stiffness):
    """The error of the disparity at a pixel, all unknowns solved for together, in NumPy."""
    views, steps = np.asarray(field.views), np.asarray(field.steps)
    colours, slopes = [], []
    for v, u in np.ndindex(views.shape[:2]):
        place = np.array([y, x]) + steps[v, u][::-1] * disparity
        step = 1e-5
        at = [place, place + [0, step], place - [0, step], place + [step, 0], place - [step, 0]]
        seen = [
            [
                ndimage.map_coordinates(views[v, u, ..., c], p[:, None], order=3, mode="mirror")[0]
                for c in range(3)
            ]
            for p in at
        ]
        own, right, left, below, above = np.asarray(seen)
        colours.append(own)
        slopes.append(np.stack([right - left, below - above]) / (2 * step))
    k = steps.reshape(-1, 2).astype(float)
    k = k - k.mean(0)
    r = np.asarray(colours) - np.mean(colours, 0)
    g = np.mean(slopes, 0)
    rows, right_side = [], []
    for c in range(3):
        drift = np.zeros((len(k), 6))
        drift[:, 2 * c : 2 * c + 2] = -k
        rows.append(np.column_stack([k @ g[:, c], drift]))
        right_side.append(-r[:, c])
    rows.append(np.column_stack([np.zeros(6), np.sqrt(stiffness) * np.eye(6)]))
    right_side.append(np.zeros(6))
    solved, *_ = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right_side), rcond=None)
    return solved[0]


def test_equals_a_regression_with_all_unknowns():
    field = plane_views(0.3, views=(3, 5), size=SHAPE)
    start = jnp.full(SHAPE, 0.26)
    found = accumulate_around(grid(field), start, PLAIN, radius=2)
    changed = np.asarray(labels(found, LAB, start, PLAIN, passes=0).disparity - start)
    for y, x in ((5, 6), (8, 9), (6, 10)):
        expected = regressed(field, 0.26, y, x, 2.0)
        np.testing.assert_allclose(changed[y, x], expected, rtol=1e-3)


def test_finds_a_plane_better_than_the_crosshair_does():
    truth, start = 0.31, jnp.full((20, 28), 0.28)
    field = plane_views(truth, noise=0.01)
    found = accumulate_around(grid(field), start, AdaptedMeasurement(), radius=2)
    lab = jnp.zeros((3, 20, 28))
    every = labels(found, lab, start, AdaptedMeasurement(), passes=2)
    arms = CrosshairSplines.of(crosshair(field))
    cross = photometric_labels(*arms, lab, start, AdaptedMeasurement(), radius=2, passes=2)
    inner = (slice(4, -4), slice(4, -4))
    errors = [float(jnp.sqrt(jnp.mean((m.disparity - truth)[inner] ** 2))) for m in (every, cross)]
    assert errors[0] < 0.8 * errors[1]
    # And says so.
    assert float(jnp.median(every.variance[inner])) < float(jnp.median(cross.variance[inner]))


def test_a_drift_of_colours_is_not_taken_for_parallax():
    """Oracle: the true disparity. Without the drift in the model it is missed by far."""
    truth = 0.31
    field = plane_views(truth, size=(20, 28))
    change = jnp.asarray([0.012, 0.006, -0.004])[None, None, None, None]
    steps = field.steps @ jnp.asarray([1.0, 0.5])
    field = LightField(jnp.clip(field.views + steps[:, :, None, None, None] * change, 0, 1))
    start, inner, errors = jnp.full((20, 28), truth), (slice(4, -4), slice(4, -4)), []
    for stiffness in (1.0, 1e9):
        params = with_values(AdaptedMeasurement, stiffness=stiffness)
        found = accumulate_around(grid(field), start, params, radius=2)
        label = labels(found, jnp.zeros((3, 20, 28)), start, params, passes=2)
        errors.append(float(jnp.sqrt(jnp.mean((label.disparity - truth)[inner] ** 2))))
    assert errors[0] < 0.2 * errors[1]
    assert errors[0] < 2e-3


@pytest.mark.parametrize("nearer", [1.0, 2.0])
def test_views_in_which_a_pixel_is_hidden_do_not_count(nearer):
    """Oracle: every pixel of the map is taken to where it lands in every view."""
    shape = (20, 24)
    disparity = np.zeros(shape)
    disparity[8:12, 9:14] = nearer
    field = plane_views(0.0, size=shape)
    found = accumulate_around(grid(field), jnp.asarray(disparity), PLAIN, radius=8)
    visible = np.zeros(shape)
    steps = np.asarray(field.steps).reshape(-1, 2).astype(int)
    for step in steps:
        front = np.full((40, 44), -np.inf)
        for y, x in np.ndindex(shape):
            at = (10 + int(y + step[1] * disparity[y, x]), 10 + int(x + step[0] * disparity[y, x]))
            front[at] = max(front[at], disparity[y, x])
        for y, x in np.ndindex(shape):
            row, column = int(y + step[1] * disparity[y, x]), int(x + step[0] * disparity[y, x])
            inside = 0 <= row < shape[0] and 0 <= column < shape[1]
            visible[y, x] += inside and front[10 + row, 10 + column] == disparity[y, x]
    count = np.asarray(found.freedom) + 1
    # A thin occluder may uncover a pixel again: what is hidden, is; what counts, is visible.
    assert (count <= visible + 1e-6).mean() > 0.97
    assert np.abs(count - visible).mean() < 1.0


def test_a_missing_view_is_not_read():
    field = plane_views(0.3, size=SHAPE)
    whole = grid(field)
    start = jnp.full(SHAPE, 0.28)
    missing = whole._replace(available=whole.available.at[3].set(False))
    spoilt = missing._replace(splines=missing.splines.at[3].set(7.0))
    for a, b in zip(
        jax.tree.leaves(accumulate_around(missing, start, PLAIN, radius=2)),
        jax.tree.leaves(accumulate_around(spoilt, start, PLAIN, radius=2)),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)


def test_a_grid_of_one_row_is_an_arm():
    field = plane_views(0.3, views=(1, 5), size=SHAPE)
    start = jnp.full(SHAPE, 0.28)
    found = accumulate_around(grid(field), start, PLAIN, radius=2)
    changed = labels(found, LAB, start, PLAIN, passes=2).disparity
    assert float(jnp.abs(changed - 0.3)[4:-4, 4:-4].max()) < 0.01
    np.testing.assert_array_equal(found.spread[1], 0)


@pytest.mark.slow
def test_gradients_in_both_modes():
    field = plane_views(0.2, views=(3, 3), size=(8, 9))
    rows = 0.15 + 0.01 * jnp.sin(jnp.arange(72.0).reshape(8, 9))
    lab = 8 * jax.random.normal(jax.random.key(0), (3, 8, 9))
    made = views_of(field)

    def loss(tree):
        planes, disparity, params = tree
        own = ViewSplines.of(made._replace(planes=planes))
        found = accumulate_around(own, disparity, params, radius=2)
        label = labels(found, lab, disparity, params, passes=1)
        return jnp.sum(label.disparity**2) + jnp.sum(1 / (1 + 1e4 * label.variance))

    check_modes(
        loss, (made.planes, rows, AdaptedMeasurement()), rtol=1e-4, step=1e-6, key=jax.random.key(2)
    )


def test_jit_and_single_precision_change_little():
    field = plane_views(0.3, size=SHAPE)
    made = grid(field)
    start = jnp.full(SHAPE, 0.28)

    def disparity(views, start):
        found = accumulate_around(views, start, AdaptedMeasurement(), radius=2)
        return labels(
            found, LAB.astype(start.dtype), start, AdaptedMeasurement(), passes=2
        ).disparity

    exact = disparity(made, start)
    np.testing.assert_allclose(exact, jax.jit(disparity)(made, start), atol=1e-12)
    single = jax.tree.map(lambda a: a if a.dtype == bool else a.astype(jnp.float32), made)
    found = disparity(single, start.astype(jnp.float32))
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, exact, atol=1e-4)
