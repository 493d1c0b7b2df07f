"""The search: the right hypothesis beside occlusions, on plain surfaces, in any set of views."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, check_modes, lean
from numpy.testing import assert_allclose, assert_array_equal
from photometry.planes import plane_arms, plane_views
from photometry.scenes import changed, textured
from scipy import ndimage

from mvedge_jax._crosshair import Crosshair, crosshair
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import Noise
from mvedge_jax.photometry.brightness import measure_noise
from mvedge_jax.photometry.matching import Agreement, Matching, best_match, hypotheses
from mvedge_jax.photometry.matching._cost import _costs
from mvedge_jax.photometry.matching._paths import aggregate
from mvedge_jax.photometry.matching._unexplained import between_views_variance
from mvedge_jax.photometry.views import views_of

PLAIN = jnp.zeros((3, 20, 28))


def lab_of(field):
    """Colours, whatever their unit, of the centre view."""
    return 100 * jnp.moveaxis(field.centre_view, -1, 0)


def test_hypotheses_find_both_sides_of_an_occlusion_edge():
    # A near card (d = 1) in front of a far wall (d = -0.5), both with their own texture.
    rng = np.random.default_rng(3)
    wall, card = (
        ndimage.gaussian_filter(rng.uniform(size=(60, 60, 3)), (0.7, 0.7, 0)) for _ in "ab"
    )
    views = np.zeros((5, 5, 32, 40, 3))
    y, x = np.mgrid[0:32, 0:40]
    for v, u in np.ndindex(5, 5):
        k, j = 2 - u, 2 - v
        # d = -0.5 is drawn with nearest samples of a texture at twice the resolution.
        far = np.kron(wall, np.ones((2, 2, 1)))[2 * y + j + 8, 2 * x + k + 8]
        near = card[y - j + 4, x - k + 4]
        inside = (x - k >= 12) & (x - k < 28) & (y - j >= 8) & (y - j < 24)
        views[v, u] = np.where(inside[..., None], near, far)
    field = LightField(jnp.asarray(views))
    truth = np.where((x >= 12) & (x < 28) & (y >= 8) & (y < 24), 1.0, -0.5)
    tried = jnp.linspace(-1, 1.5, 11)
    found = hypotheses(crosshair(field), lab_of(field), tried, Matching(), window=2).disparity
    assert float(found.min()) >= -1
    assert float(found.max()) <= 1.5
    assert (np.abs(np.asarray(found) - truth) > 0.13)[4:-4, 4:-4].mean() < 0.06


def test_hypotheses_do_not_see_a_missing_view():
    across, down = plane_arms(0.5)
    lab, there = 100 * across.planes[2], across.available.at[0].set(False)
    found = []
    for value in (0.0, 0.9):
        arm = across._replace(planes=across.planes.at[0].set(value), available=there)
        tried = jnp.linspace(-1, 1, 41)
        found.append(hypotheses(Crosshair(arm, down), lab, tried, Matching(), window=1).disparity)
    assert_array_equal(found[0], found[1])
    assert float((jnp.abs(found[0] - 0.5) < 0.01).mean()) > 0.95


@pytest.mark.parametrize(("count", "reach"), [(3, 1), (5, 2), (5, 4)])
def test_paths_are_the_cheapest_of_all_paths(count, reach):
    # Brute force along a row: every sequence of disparities that ends at the last pixel.
    rng = np.random.default_rng(4)
    cost, lab = rng.uniform(size=(count, 1, 5)), 10 * rng.uniform(size=(3, 1, 5))
    prices = {"slant": 0.1, "jump": 0.5, "colour": 6.0}
    found = aggregate(
        *map(jnp.asarray, (cost, lab)), **jax.tree.map(jnp.asarray, prices), reach=reach
    )
    steps = np.linalg.norm(np.diff(lab[:, 0], axis=1), axis=0)
    jumps = 0.5 / (1 + steps / 6.0)

    def price(path):
        moves = np.abs(np.diff(path))
        change = np.where(moves <= reach, np.minimum(0.1 * moves, jumps), jumps)
        return sum(cost[d, 0, i] for i, d in enumerate(path)) + change.sum()

    paths = np.array(list(np.ndindex(*[count] * 5)))
    totals = np.array([price(path) for path in paths])
    ends = np.array([totals[paths[:, -1] == d].min() for d in range(count)])
    # The aggregate is normalised along the path, and holds the vertical and the backward paths too,
    # which at the last pixel of a single row are the pixel's own cost.
    expected = ends + 3 * cost[:, 0, -1]
    last = np.asarray(found)[:, 0, -1]
    assert_allclose(last - last.min(), expected - expected.min(), atol=1e-6)


def test_a_plain_surface_follows_its_surroundings():
    across, down = plane_arms(0.5)
    hole = np.s_[..., 6:14, 10:18]
    planes = across.planes.at[hole].set(0.5), down.planes.at[..., 10:18, 6:14].set(0.5)
    arms = Crosshair(across._replace(planes=planes[0]), down._replace(planes=planes[1]))
    # Colours alike, so that nothing but the neighbours can fill the hole in the texture.
    found = hypotheses(arms, PLAIN, jnp.linspace(-1, 1, 9), Matching(), window=1).disparity
    assert float(jnp.median(jnp.abs(found[6:14, 10:18] - 0.5))) < 0.1


def test_gloss_does_not_move_the_best_hypothesis():
    # Faint texture under a change of colour from view to view that is larger than the texture.
    across, down = (
        a._replace(planes=0.5 + 0.02 * (a.planes - 0.5) + 0.002 * a.steps[:, None, None, None])
        for a in plane_arms(0.5)
    )

    def wrong(drift):
        # Costs saturate at what the faint texture differs by.
        truncation = jnp.asarray(4 * (1e-4 * 255) ** 2)
        params = Matching(drift=jnp.asarray(drift), truncation=truncation)
        arms, lab, tried = Crosshair(across, down), 100 * across.planes[2], jnp.linspace(-1, 1, 17)
        found = hypotheses(arms, lab, tried, params, window=2).disparity
        return float((jnp.abs(found - 0.5)[4:-4, 4:-4] > 0.07).mean())

    assert wrong(6.0 / 255) < 0.02
    assert wrong(0.0) > 0.2


def test_no_drift_is_granted_beside_an_outline():
    # With the colours of a strong outline nearby, the limit of the drift changes nothing.
    lab, tried = PLAIN.at[0, ::4].set(1e4), jnp.linspace(-1, 1, 9)
    found = [
        hypotheses(plane_arms(0.5), lab, tried, Matching(drift=jnp.asarray(d)), window=1).disparity
        for d in (0.0, 6.0 / 255)
    ]
    assert_allclose(found[0], found[1], atol=1e-6)


def of_crosshair(field):
    """The views of the crosshair alone, as a set of views in any places."""
    rows, columns = (np.arange(n) == n // 2 for n in field.views.shape[:2])
    views = views_of(field)
    cross = (rows[:, None] | columns[None]).reshape(-1)
    own = int(np.argmax((rows[:, None] & columns[None]).reshape(-1)))
    order = np.concatenate([[own], np.delete(np.arange(cross.size), own)])
    chosen = np.flatnonzero(cross[order])
    return jax.tree.map(lambda leaf: leaf[chosen], views)


@pytest.mark.parametrize("views", [(1, 3), (3, 3)])
def test_costs_of_a_set_of_views_beside_those_of_the_halves_of_arms(views):
    """Where nothing is interpolated, away from the border."""
    field = plane_views(1.0, views=views, noise=0.02)
    tried, noise = jnp.asarray([-1.0, 0.0, 1.0, 2.0]), Noise.of(jnp.zeros(()))
    rigid, costs = Matching(drift=jnp.asarray(0.0)), lean(partial(_costs, window=1))
    arms, stack = (
        np.asarray(costs(of(field), lab_of(field), tried, rigid, noise))[:, 5:-5, 5:-5]
        for of in (crosshair, of_crosshair)
    )
    if views == (1, 3):
        # The arm without views confirms nothing: 1.
        assert_allclose(stack, 2 * (arms - 1), atol=1e-12)
    else:
        # The better half of all views costs no more than those of two arms.
        assert (stack <= arms + 1e-12).all()
        assert (stack < arms - 1e-6).mean() > 0.1


@pytest.mark.parametrize("truth", [0.3, -0.65])
def test_a_crosshair_as_a_set_of_views_has_the_same_best_disparities(truth):
    """What is left: linear against cubic interpolation, the half of all views against two halves.

    A change of colour, besides, is granted to every view by itself, and not along an arm.
    """
    field, tried = plane_views(truth), jnp.linspace(-1, 1, 17)
    arms, stack = (
        best_match(of(field), lab_of(field), tried, Matching(), window=2)[0]
        for of in (crosshair, of_crosshair)
    )
    off = np.abs(np.asarray(arms - stack))[5:-5, 5:-5]
    assert np.median(off) < 0.01
    assert (off < 0.5 * float(tried[1] - tried[0])).mean() > 0.98


def test_a_view_of_a_set_that_is_not_to_be_read_has_no_say():
    views, tried = of_crosshair(plane_views(0.3)), jnp.linspace(-1, 1, 9)
    missing = views._replace(available=views.available.at[2].set(False))
    spoilt = missing._replace(planes=missing.planes.at[2].set(0.7))
    one, other = (best_match(v, PLAIN, tried, Matching(), window=1)[0] for v in (missing, spoilt))
    assert_array_equal(one, other)


@pytest.mark.parametrize("sigma", [0.01, 0.03])
def test_known_noise_is_recovered_from_any_set_of_views(sigma):
    field = changed(textured(), noise=sigma)
    centre = jnp.moveaxis(field.centre_view, -1, 0)
    tried = jnp.linspace(-1, 1, 17).astype(centre.dtype)
    between = lean(between_views_variance)(of_crosshair(field), tried)
    found = measure_noise(centre, jnp.float32(1), between=between)
    assert abs(float(found.deviation) / sigma - 1) < 0.1


def test_noise_is_that_of_the_longer_arm_whatever_the_shape_of_its_views():
    tall = changed(textured(), noise=0.02).views[:, 1:-1]
    tried = jnp.linspace(-0.5, 1, 7, dtype=tall.dtype)
    found = [
        between_views_variance(crosshair(LightField(views)), tried, finer=2)
        for views in (tall, jnp.transpose(tall, (1, 0, 3, 2, 4)))
    ]
    assert float(found[0]) == pytest.approx(float(found[1]), rel=1e-6)


@pytest.mark.parametrize("params", [Matching(), Matching(agreement=Agreement())])
def test_derivatives_of_the_costs_match_differences(params):
    field = plane_views(0.3, views=(3, 3), size=(12, 14))
    views, noise, lab = views_of(field), Noise.of(jnp.asarray(0.01)), lab_of(field)
    chosen = jax.random.normal(jax.random.key(0), (3, 12, 14))

    def total(tree):
        planes, tried, params = tree
        moved = views._replace(planes=planes)
        return jnp.sum(chosen * _costs(moved, lab, tried, params, noise, 1))

    tree = (views.planes, jnp.asarray([-0.31, 0.17, 0.42]), params)
    check_gradient(total, tree, rtol=1e-4, step=1e-8, key=jax.random.key(1))


@pytest.mark.slow
def test_derivatives_of_the_hypotheses_match_differences():
    across, down = plane_arms(0.3, views=(3, 3), size=(8, 9))
    tried = jnp.linspace(-0.5, 1, 7)

    def loss(tree):
        planes, lab, params = tree
        arms = Crosshair(across._replace(planes=planes), down)
        found = hypotheses(arms, lab, tried, params, window=1)
        return jnp.sum(found.disparity**2 + found.variance_around(found.disparity))

    tree = (across.planes, 100 * across.planes[1], Matching())
    check_modes(loss, tree, rtol=1e-4, step=1e-7, key=jax.random.key(3))
