"""Depth of every view: against cards with known depth, its derivatives, grids of any shape."""

import inspect
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from all_views.cards import FAR, NEAR, cards
from helpers import dot, random_like

from experiments.peers.reprojection import reproject_views
from mvedge_jax.all_views import ViewDepth, depth_of_views
from mvedge_jax.depth import DepthResult, DepthStats
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry.brightness import Exposure, Noise


def _known(field):
    """The true center map as a result, of views without noise."""
    dtype = field.views.dtype
    exposure = Exposure(jnp.ones((), dtype), jnp.ones(field.views.shape[:2], dtype))
    unread: Any = None
    read = {"noise": Noise.of(jnp.zeros((), dtype)), "exposure": exposure}
    stats = DepthStats(**{name: read.get(name, unread) for name in DepthStats._fields})
    error = jnp.full_like(field.truth.disparity, 0.01)
    return DepthResult(field.truth.disparity, error, unread, unread, unread, stats)


def _bad(maps, field):
    return float(jnp.mean(jnp.abs(maps - field.truth.view_disparity) > 0.1))


def test_surfaces_hidden_in_the_center_view_are_found():
    field = cards()
    result = _known(field)
    found = depth_of_views(field, result, ViewDepth.for_light_field(field))
    assert _bad(found.disparity, field) < 0.002
    np.testing.assert_array_equal(found.disparity[2, 2], result.disparity)
    # What the center view shows of the wall and of the card, by moving it to every view.
    y, x = np.mgrid[:40, :48]
    for v, u in np.ndindex(5, 5):
        d = np.asarray(field.truth.view_disparity[v, u])
        b, a = (y + (v - 2) * d).astype(int), (x + (u - 2) * d).astype(int)
        inside = (b >= 0) & (b < 40) & (a >= 0) & (a < 48)
        center = np.asarray(result.disparity)[b.clip(0, 39), a.clip(0, 47)]
        seen = inside & (center == d)
        assert ((np.asarray(found.source[v, u]) == 0) == seen).mean() > 0.99
    assert found.overflow == 0
    assert jnp.isfinite(found.error).all()
    assert (found.error >= 0).all()
    # Neither the truth nor a name is read, so neither has its own program.
    before, other = depth_of_views.traces, field.without_truth().renamed("other")
    again = depth_of_views(other, result, ViewDepth.for_light_field(field))
    np.testing.assert_array_equal(again.disparity, found.disparity)
    assert depth_of_views.traces == before


def test_a_wrong_first_guess_is_put_right_by_the_views():
    # Seen from the center, the wall behind the card seems to be a step further away all around it.
    field = cards()
    result = _known(field)
    depth = jnp.where(result.disparity == NEAR, NEAR, result.disparity)
    rim = jnp.abs(jnp.arange(48) - 24) < 16
    depth = jnp.where(rim[None] & (depth == FAR), -1.15, depth)
    found = depth_of_views(
        field, result._replace(disparity=depth), ViewDepth.for_light_field(field)
    )
    new = found.source == 1
    error = jnp.abs(found.disparity - field.truth.view_disparity)
    assert float(jnp.median(error[new])) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("grid", [(1, 5), (5, 1), (3, 7)])
def test_any_grid(grid):
    field = cards((*grid, 33, 40))
    result, model = _known(field), ViewDepth.for_light_field(field)
    found = depth_of_views(field, result, model)
    assert _bad(found.disparity, field) < 0.004
    assert _bad(reproject_views(field.truth.disparity, field.steps), field) < 0.02
    few = depth_of_views(field, result, model.replace(capacity=10))
    assert few.overflow > 0
    assert 0 < (few.source == 1).sum() < (found.source == 1).sum()


def test_missing_views_are_not_read():
    field = cards()
    there = np.zeros((5, 5), bool)
    there[2], there[:, 2] = True, True
    model, result = ViewDepth.for_light_field(field), _known(field)

    def run(fill):
        views = jnp.where(there[:, :, None, None, None], field.views, fill)
        partial = LightField(views, available=there, disparity_range=field.disparity_range)
        return depth_of_views(partial, result, model)

    black, white = run(0.0), run(1.0)
    for a, b in zip(black, white, strict=True):
        np.testing.assert_array_equal(a, b)
    assert _bad(black.disparity, field) < 0.01


@pytest.mark.slow
def test_derivatives_of_off_center_maps_equal_differences():
    shape = (3, 3, 24, 32)
    field = cards(shape, np.float64)
    exact = ViewDepth.for_light_field(field, choices={"tolerance": 1e-12})
    keys = jax.random.split(jax.random.key(1), 4)
    # Off the exact copies and the whole disparities, where minima and selections would tie.
    views = jnp.clip(field.views + 1e-3 * jax.random.normal(keys[0], field.views.shape), 0, 1)
    center = _known(field)
    depth = center.disparity + 0.02 * jax.random.normal(keys[1], shape[2:])
    weights = jax.random.normal(keys[2], shape)

    def loss(tree):
        model, disparity, views = tree
        lit = eqx.tree_at(lambda f: f.views, field, views)
        found = depth_of_views(lit, center._replace(disparity=disparity), model)
        return jnp.sum(weights * (found.disparity + found.error))

    tree = (exact, depth, views)
    gradient = jax.jit(jax.grad(loss))(tree)
    value, forward = jax.jit(loss), jax.jit(lambda d: jax.jvp(loss, (tree,), (d,))[1])
    nothing = jax.tree.map(jnp.zeros_like, tree)
    # At a step of 1e-6 in all numbers of the model, 300 pixels pass a kink; at 1e-7, none does.
    step = 1e-8
    for part, leaves in enumerate(tree):
        some = random_like(leaves, key=keys[3])
        direction = tuple(some if i == part else nothing[i] for i in range(3))
        reverse = dot(gradient, direction)

        def moved(t, direction=direction):
            return value(jax.tree.map(lambda a, b: a + t * b, tree, direction))

        numeric = float(moved(step) - moved(-step)) / (2 * step)
        np.testing.assert_allclose(forward(direction), reverse, rtol=1e-9)
        np.testing.assert_allclose(reverse, numeric, rtol=1e-4)


def test_other_sizes_are_refused():
    field = cards()
    wrong = _known(field)._replace(disparity=jnp.zeros((8, 8)))
    with pytest.raises(ValueError, match=r"`result.disparity` must have the size"):
        inspect.unwrap(depth_of_views)(field, wrong, ViewDepth.for_light_field(field))
    bad = {"capacity": 0, "measurement.radius": 0, "hypotheses": 1, "tolerance": 0.0}
    for path, value in bad.items():
        with pytest.raises(ValueError, match=f"`{path.split('.')[-1]}` must be"):
            ViewDepth.for_light_field(field, choices={path: value})
    with pytest.raises(ValueError, match=r"`matching.color` is no path of `ViewDepth`"):
        ViewDepth.for_light_field(field, choices={"matching.color": 1.0})
    model = ViewDepth.for_light_field(field, choices={"measurement.passes": 1})
    assert model.measurement.passes == 1
    assert "matching.jump = 0.8" in str(model)
    with pytest.raises(ValueError, match=r"`precision` must be finite .*, got nan"):
        depth_of_views(field, _known(field), model.replace(precision=float("nan")))
    with pytest.raises(TypeError, match="`result` must be DepthResult, got ViewDepth"):
        depth_of_views(field, model, _known(field))
