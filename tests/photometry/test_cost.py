"""The search: the right hypothesis beside occlusions, on plain surfaces, without some views."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, random_like
from photometry.planes import plane_arms
from scipy import ndimage

from mvedge_jax._crosshair import Crosshair, crosshair
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry.matching import Matching, hypotheses
from mvedge_jax.photometry.matching._paths import aggregate


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
    arms = crosshair(LightField(jnp.asarray(views)))
    truth = np.where((x >= 12) & (x < 28) & (y >= 8) & (y < 24), 1.0, -0.5)
    lab = 100 * jnp.moveaxis(jnp.asarray(views[2, 2]), -1, 0)
    tried = jnp.linspace(-1, 1.5, 11)
    found = hypotheses(arms, lab, tried, Matching(), window=2).disparity
    assert float(found.min()) >= -1
    assert float(found.max()) <= 1.5
    inner = (slice(4, -4), slice(4, -4))
    wrong = (np.abs(np.asarray(found) - truth) > 0.13)[inner]
    assert wrong.mean() < 0.06


def test_hypotheses_do_not_see_a_missing_view():
    across, down = plane_arms(0.5)
    lab = 100 * across.planes[2]
    there = across.available.at[0].set(False)
    tried = jnp.linspace(-1, 1, 41)
    found = [
        hypotheses(
            Crosshair(
                across._replace(planes=across.planes.at[0].set(value), available=there), down
            ),
            lab,
            tried,
            Matching(),
            window=1,
        ).disparity
        for value in (0.0, 0.9)
    ]
    np.testing.assert_array_equal(found[0], found[1])
    assert float((jnp.abs(found[0] - 0.5) < 0.01).mean()) > 0.95


@pytest.mark.parametrize(("count", "reach"), [(3, 1), (5, 2), (5, 4)])
def test_paths_are_the_cheapest_of_all_paths(count, reach):
    # Brute force along a row: every sequence of disparities that ends at the last pixel.
    rng = np.random.default_rng(4)
    cost, lab = rng.uniform(size=(count, 1, 5)), 10 * rng.uniform(size=(3, 1, 5))
    slant, jump, colour = 0.1, 0.5, 6.0
    found = aggregate(
        jnp.asarray(cost),
        jnp.asarray(lab),
        slant=jnp.asarray(slant),
        jump=jnp.asarray(jump),
        colour=jnp.asarray(colour),
        reach=reach,
    )
    steps = np.linalg.norm(np.diff(lab[:, 0], axis=1), axis=0)
    prices = jump / (1 + steps / colour)

    def price(path):
        moves = np.abs(np.diff(path))
        change = np.where(moves <= reach, np.minimum(moves * slant, prices), prices)
        return sum(cost[d, 0, i] for i, d in enumerate(path)) + change.sum()

    paths = np.array(list(np.ndindex(*[count] * 5)))
    prices_of_paths = np.array([price(path) for path in paths])
    ends = np.array([prices_of_paths[paths[:, -1] == d].min() for d in range(count)])
    # The aggregate is normalised along the path, and holds the vertical and the backward paths too,
    # which at the last pixel of a single row are the pixel's own cost.
    expected = ends + 3 * cost[:, 0, -1]
    last = np.asarray(found)[:, 0, -1]
    np.testing.assert_allclose(last - last.min(), expected - expected.min(), atol=1e-6)


def test_a_plain_surface_follows_its_surroundings():
    across, down = plane_arms(0.5)
    hole = np.s_[..., 6:14, 10:18]
    planes = across.planes.at[hole].set(0.5), down.planes.at[..., 10:18, 6:14].set(0.5)
    arms = Crosshair(across._replace(planes=planes[0]), down._replace(planes=planes[1]))
    # Colours alike, so that nothing but the neighbours can fill the hole in the texture.
    found = hypotheses(
        arms, jnp.zeros((3, 20, 28)), jnp.linspace(-1, 1, 9), Matching(), window=1
    ).disparity
    assert float(jnp.median(jnp.abs(found[6:14, 10:18] - 0.5))) < 0.1


def test_gloss_does_not_move_the_best_hypothesis():
    # Faint texture under a change of colour from view to view that is larger than the texture.
    across, down = (
        a._replace(planes=0.5 + 0.02 * (a.planes - 0.5) + 0.002 * a.steps[:, None, None, None])
        for a in plane_arms(0.5)
    )
    lab = 100 * across.planes[2]
    tried = jnp.linspace(-1, 1, 17)

    def wrong(drift):
        # Costs saturate at what the faint texture differs by.
        truncation = jnp.asarray(4 * (1e-4 * 255) ** 2)
        params = Matching(drift=jnp.asarray(drift), truncation=truncation)
        found = hypotheses(Crosshair(across, down), lab, tried, params, window=2).disparity
        return float((jnp.abs(found - 0.5)[4:-4, 4:-4] > 0.07).mean())

    assert wrong(6.0 / 255) < 0.02
    assert wrong(0.0) > 0.2


def test_no_drift_is_granted_beside_an_outline():
    # With the colours of a strong outline nearby, the limit of the drift changes nothing.
    across, down = plane_arms(0.5)
    lab = jnp.zeros((3, 20, 28)).at[0, ::4].set(1e4)
    tried = jnp.linspace(-1, 1, 9)
    found = [
        hypotheses(
            Crosshair(across, down), lab, tried, Matching(drift=jnp.asarray(d)), window=1
        ).disparity
        for d in (0.0, 6.0 / 255)
    ]
    np.testing.assert_allclose(found[0], found[1], atol=1e-6)


@pytest.mark.slow
def test_derivatives_of_the_hypotheses_match_differences():
    across, down = plane_arms(0.3, views=(3, 3), size=(8, 9))
    lab = 100 * across.planes[1]
    tried = jnp.linspace(-0.5, 1, 7)

    def loss(tree):
        planes, lab, params = tree
        arms = Crosshair(across._replace(planes=planes), down)
        found = hypotheses(arms, lab, tried, params, window=1)
        return jnp.sum(found.disparity**2 + found.variance_around(found.disparity))

    tree = (across.planes, lab, Matching())
    check_gradient(loss, tree, rtol=1e-4, step=1e-7, key=jax.random.key(3))
    direction = random_like(tree, key=jax.random.key(4))
    _, tangent = jax.jit(lambda t, d: jax.jvp(loss, (t,), (d,)))(tree, direction)
    gradient = jax.tree.leaves(jax.jit(jax.grad(loss))(tree))
    pairs = zip(gradient, jax.tree.leaves(direction), strict=True)
    assert float(tangent) == pytest.approx(sum(float(jnp.vdot(a, b)) for a, b in pairs), rel=1e-6)


def test_without_texture_all_hypotheses_are_as_likely():
    arms = crosshair(LightField(jnp.full((3, 3, 12, 14, 3), 0.4)))
    tried = jnp.linspace(-2, 1, 7)
    found = hypotheses(arms, jnp.zeros((3, 12, 14)), tried, Matching(), window=1)
    np.testing.assert_allclose(found.mean, -0.5, atol=1e-9)
    np.testing.assert_allclose(found.variance, np.var(tried), rtol=1e-9)
    np.testing.assert_allclose(
        found.variance_around(jnp.full((12, 14), tried[0])), np.mean((tried + 2) ** 2)
    )


def test_the_posterior_is_narrow_on_texture_and_wide_where_a_texture_repeats():
    across, down = plane_arms(0.5)
    tried = jnp.linspace(-1, 1, 41)
    lab = 100 * across.planes[across.centre]
    found = hypotheses(Crosshair(across, down), lab, tried, Matching(), window=2)
    inner = (slice(6, -6), slice(6, -6))
    assert float(jnp.median(found.variance_around(found.disparity)[inner])) < 0.05**2

    # Columns that repeat after 4 px: -3, 1 and 5 px per view step explain all views.
    columns = jnp.asarray([0.2, 0.5, 0.9, 0.4])[(jnp.arange(40)) % 4]
    views = jnp.stack([jnp.roll(columns, s) for s in (1, 0, -1)])
    views = jnp.broadcast_to(views[None, :, None, :, None], (3, 3, 12, 40, 3))
    arms = crosshair(LightField(views))
    lab = 100 * jnp.moveaxis(views[1, 1], -1, 0)
    found = hypotheses(arms, lab, jnp.arange(-5.0, 7.0), Matching(), window=2)
    np.testing.assert_allclose(found.mean[:, 8:-8], 1, atol=0.1)
    np.testing.assert_allclose(found.variance[:, 8:-8], 32 / 3, rtol=0.1)
