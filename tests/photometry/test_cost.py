"""The search: the right hypothesis beside occlusions, on plain surfaces, in any set of views."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, lean
from photometry.scenes import of_crosshair, plane_arms, plane_views

from mvedge_jax._crosshair import Crosshair, crosshair
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import Noise
from mvedge_jax.photometry.matching import Agreement, Matching, best_match, hypotheses
from mvedge_jax.photometry.matching._agreement import Window
from mvedge_jax.photometry.matching._cost import _costs
from mvedge_jax.photometry.matching._paths import aggregate
from mvedge_jax.photometry.views import views_of

PLAIN = jnp.zeros((3, 20, 28))


def lab_of(field):
    """Colors, whatever their unit, of the center view."""
    return 100 * jnp.moveaxis(field.center_view, -1, 0)


@pytest.mark.parametrize(("count", "reach"), [(3, 1), (5, 2), (5, 4)])
def test_paths_are_the_cheapest_of_all_paths(count, reach):
    # Brute force along a row: every sequence of disparities that ends at the last pixel.
    rng = np.random.default_rng(4)
    cost, lab = rng.uniform(size=(count, 1, 5)), 10 * rng.uniform(size=(3, 1, 5))
    prices = {"slant": 0.1, "jump": 0.5, "color": 6.0}
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
    # The aggregate is normalized along the path, and holds the vertical and the backward paths too,
    # which at the last pixel of a single row are the pixel's own cost.
    expected = ends + 3 * cost[:, 0, -1]
    last = np.asarray(found)[:, 0, -1]
    np.testing.assert_allclose(last - last.min(), expected - expected.min(), atol=1e-6)


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
        np.testing.assert_allclose(stack, 2 * (arms - 1), atol=1e-12)
    else:
        # The better half of all views costs no more than those of two arms.
        assert (stack <= arms + 1e-12).all()
        assert (stack < arms - 1e-6).mean() > 0.1


@pytest.mark.parametrize("of", [crosshair, of_crosshair])
def test_a_view_that_is_not_to_be_read_has_no_say(of):
    field, tried, found = plane_views(0.5), jnp.linspace(-1, 1, 41), []
    for value in (0.0, 0.9):
        views = of(field)
        own = views if of is of_crosshair else views.horizontal
        own = own._replace(
            planes=own.planes.at[1].set(value), available=own.available.at[1].set(False)
        )
        views = own if of is of_crosshair else Crosshair(own, views.vertical)
        found.append(best_match(views, lab_of(field), tried, Matching(), window=1)[0])
    np.testing.assert_array_equal(found[0], found[1])
    assert float((jnp.abs(found[0] - 0.5) < 0.01).mean()) > 0.95


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
    lab = 100 * across.planes[across.center]
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


def test_a_correlation_is_that_of_the_windows_and_knows_no_gain():
    rng = np.random.default_rng(0)
    colors, other = jnp.asarray(rng.uniform(size=(2, 3, 8, 9)))
    weights = jnp.full((9, 8, 9), 1 / 9)
    window = Window.of(colors, weights, jnp.asarray(1e-9))
    found = np.asarray(window.unlike(other))[4, 4]
    both = np.stack([np.asarray(a)[:, 3:6, 3:6].reshape(3, 9) for a in (colors, other)])
    both = both - both.mean(-1, keepdims=True)
    expected = (both[0] * both[1]).sum() / np.sqrt((both**2).sum((1, 2)).prod())
    np.testing.assert_allclose(found, 0.5 * (1 - expected), rtol=1e-6)
    np.testing.assert_allclose(window.unlike(0.7 * colors + 0.2), 0, atol=1e-6)
    plain = window.unlike(jnp.full_like(colors, 0.5))
    np.testing.assert_allclose(plain, 0.5, atol=1e-6)
