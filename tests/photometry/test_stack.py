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
from mvedge_jax.photometry.matching import Matching, best_match
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


def test_derivatives_of_the_costs_match_differences():
    field = plane_views(0.3, views=(3, 3), size=(12, 14))
    views, noise = views_of(field), Noise.of(jnp.asarray(0.01))
    lab = 100 * jnp.moveaxis(field.centre_view, -1, 0)
    chosen = jax.random.normal(jax.random.key(0), (3, 12, 14))

    def total(tree):
        planes, tried, params = tree
        moved = views._replace(planes=planes)
        return jnp.sum(chosen * _costs(moved, lab, tried, params, noise, 1))

    tree = (views.planes, jnp.asarray([-0.31, 0.17, 0.42]), PARAMS)
    check_gradient(total, tree, rtol=1e-4, step=1e-8, key=jax.random.key(1))


@pytest.mark.parametrize("sigma", [0.01, 0.03])
def test_known_noise_is_recovered_from_any_set_of_views(sigma):
    field = changed(textured(), noise=sigma)
    centre = jnp.moveaxis(field.centre_view, -1, 0)
    tried = jnp.linspace(-1, 1, 17).astype(centre.dtype)
    between = between_views_variance(of_crosshair(field), tried)
    found = measure_noise(centre, jnp.float32(1), between=between)
    assert abs(float(found.deviation) / sigma - 1) < 0.1
