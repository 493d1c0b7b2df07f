"""Costs over views in any places, against those over two arms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient
from photometry.planes import plane_views
from photometry.scenes import changed, textured

from mvedge_jax._crosshair import crosshair
from mvedge_jax.photometry import Noise
from mvedge_jax.photometry.brightness import measure_noise
from mvedge_jax.photometry.matching import Agreement, Matching, best_match
from mvedge_jax.photometry.matching._agreement import Window
from mvedge_jax.photometry.matching._cost import _costs
from mvedge_jax.photometry.matching._unexplained import between_views_variance
from mvedge_jax.photometry.views import views_of

PARAMS = Matching()
RIGID = Matching(drift=jnp.asarray(0.0))
INNER = (slice(5, -5), slice(5, -5))


def of_crosshair(field):
    """The views of the crosshair alone, as a set."""
    rows, columns = (np.arange(n) == n // 2 for n in field.views.shape[:2])
    views = views_of(field)
    cross = (rows[:, None] | columns[None]).reshape(-1)
    own = int(np.argmax((rows[:, None] & columns[None]).reshape(-1)))
    order = np.concatenate([[own], np.delete(np.arange(cross.size), own)])
    chosen = np.flatnonzero(cross[order])
    return jax.tree.map(lambda leaf: leaf[chosen], views)


def whole_shifts(views):
    """Costs of arms and of a set of views where nothing is interpolated, away from the border."""
    field = plane_views(1.0, views=views, noise=0.02)
    lab = 100 * jnp.moveaxis(field.centre_view, -1, 0)
    tried, noise = jnp.asarray([-1.0, 0.0, 1.0, 2.0]), Noise.of(jnp.zeros(()))
    both = (
        _costs(of, lab, tried, RIGID, noise, 1) for of in (crosshair(field), of_crosshair(field))
    )
    return (np.asarray(costs)[:, 5:-5, 5:-5] for costs in both)


def test_two_views_cost_what_the_halves_of_an_arm_do():
    arms, stack = whole_shifts((1, 3))
    # The arm without views confirms nothing: 1.
    np.testing.assert_allclose(stack, 2 * (arms - 1), atol=1e-12)


def test_the_better_half_of_all_views_costs_no_more_than_those_of_two_arms():
    arms, stack = whole_shifts((3, 3))
    assert (stack <= arms + 1e-12).all()
    assert (stack < arms - 1e-6).mean() > 0.1


@pytest.mark.parametrize("truth", [0.3, -0.65])
def test_a_crosshair_as_a_set_of_views_has_the_same_best_disparities(truth):
    """What is left: linear against cubic interpolation, the half of all views against two halves.

    A change of colour, besides, is granted to every view by itself, and not along an arm.
    """
    field = plane_views(truth)
    lab = 100 * jnp.moveaxis(field.centre_view, -1, 0)
    tried = jnp.linspace(-1, 1, 17)
    arms, stack = (
        best_match(views, lab, tried, PARAMS, window=2)[0]
        for views in (crosshair(field), of_crosshair(field))
    )
    off = np.abs(np.asarray(arms - stack))[INNER]
    assert np.median(off) < 0.01
    assert (off < 0.5 * float(tried[1] - tried[0])).mean() > 0.98


def test_a_view_that_is_not_to_be_read_has_no_say():
    field = plane_views(0.3)
    views, lab = of_crosshair(field), jnp.zeros((3, 20, 28))
    missing = views._replace(available=views.available.at[2].set(False))
    spoilt = missing._replace(planes=missing.planes.at[2].set(0.7))
    tried = jnp.linspace(-1, 1, 9)
    one, other = (best_match(v, lab, tried, PARAMS, window=1)[0] for v in (missing, spoilt))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("params", [PARAMS, Matching(agreement=Agreement())])
def test_derivatives_of_the_costs_match_differences(params):
    field = plane_views(0.3, views=(3, 3), size=(12, 14))
    views, noise = views_of(field), Noise.of(jnp.asarray(0.01))
    lab = 100 * jnp.moveaxis(field.centre_view, -1, 0)
    chosen = jax.random.normal(jax.random.key(0), (3, 12, 14))

    def total(tree):
        planes, tried, params = tree
        moved = views._replace(planes=planes)
        return jnp.sum(chosen * _costs(moved, lab, tried, params, noise, 1))

    tree = (views.planes, jnp.asarray([-0.31, 0.17, 0.42]), params)
    check_gradient(total, tree, rtol=1e-4, step=1e-8, key=jax.random.key(1))


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


def test_photographs_that_do_not_show_a_pixel_count_little():
    costs = jnp.asarray([0.1, 0.12, 0.9, 1.0])[:, None, None]
    found = float(Agreement().pooled(costs)[0, 0])
    assert 0.1 < found < 0.2
    np.testing.assert_allclose(
        Agreement(temperature=jnp.asarray(100.0)).pooled(costs), costs.mean(), rtol=2e-3
    )
    np.testing.assert_allclose(
        Agreement(temperature=jnp.asarray(1e-5)).pooled(costs), 0.1, rtol=1e-3
    )


@pytest.mark.parametrize("sigma", [0.01, 0.03])
def test_known_noise_is_recovered_from_any_set_of_views(sigma):
    field = changed(textured(), noise=sigma)
    centre = jnp.moveaxis(field.centre_view, -1, 0)
    tried = jnp.linspace(-1, 1, 17).astype(centre.dtype)
    between = between_views_variance(of_crosshair(field), tried)
    found = measure_noise(centre, jnp.float32(1), between=between)
    assert abs(float(found.deviation) / sigma - 1) < 0.1
