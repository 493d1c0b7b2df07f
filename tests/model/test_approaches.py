"""What corrects a first map: views that agree, bending that is polished."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, count_traces
from numpy.testing import assert_allclose, assert_array_equal
from photometry.scenes import plane_views

from mvedge_jax.lightfield import GroundTruth, LightField
from mvedge_jax.losses import all_views, gather_views
from mvedge_jax.model import DepthModel, Renderer, Start, optimize_edges, render_model
from mvedge_jax.model.approaches import Bending, ByEvidence, ByReprojection, ViewAgreement, polish
from mvedge_jax.model.approaches._approach import explained
from mvedge_jax.model.approaches._evidence import agreed_correction
from mvedge_jax.model.approaches._polish import bending
from mvedge_jax.model.objectives import SelfSupervised
from mvedge_jax.model.optimization import Rates, all_at_once, one_at_a_time

SHAPE = (20, 22)


def scene(*, noise=0.0, dtype: type = np.float32):
    """All views of a textured plane of disparity 0.3."""
    field = plane_views(0.3, size=SHAPE, noise=noise)
    field = LightField(field.views.astype(dtype))
    return gather_views(field, choice=all_views(field))


def flat(value):
    return jnp.full(SHAPE, value, jnp.float32)


def inner(image):
    return np.asarray(image)[5:-5, 5:-5]


def agreed(views, disparity, params=None):
    params = ViewAgreement() if params is None else params
    return agreed_correction(views, disparity, params, radius=2)


def test_halves_of_the_views_confirm_an_error_and_nothing_else():
    for wrong in (0.03, 0.0):
        found = agreed(scene(), flat(0.3 + wrong))
        assert_allclose(inner(found.change), -wrong, atol=0.004)
        assert wrong == 0 or inner(found.share).min() > 0.9
    blind = eqx.tree_at(lambda v: v.available, scene(), jnp.zeros(24, bool))
    assert_allclose(agreed(blind, flat(0.33)).change, 0, atol=1e-6)


def test_one_trace_serves_all_parameters_and_x64_changes_little():
    single, double = scene(), scene(dtype=np.float64)
    traced, traces = count_traces(lambda v, d, p: agreed(v, d, p).change)
    first = traced(single, flat(0.31), ViewAgreement())
    traced(single, flat(0.31), ViewAgreement(region=jnp.asarray(2.0)))
    assert traces() == 1
    assert first.dtype == jnp.float32
    exact = agreed(double, flat(0.31).astype(jnp.float64)).change
    assert_allclose(first, exact, atol=2e-4)


def test_nothing_is_measured_beside_depth_steps():
    """Windows reach across them, and so do neighbors that share their measurements."""
    step = jnp.where(jnp.arange(SHAPE[1]) > SHAPE[1] // 2, 0.8, 0.3)
    found = agreed(scene(), jnp.broadcast_to(step, SHAPE).astype(jnp.float32))
    beside = np.abs(np.arange(SHAPE[1]) - (SHAPE[1] // 2 + 0.5)) < 5
    assert_array_equal(np.asarray(found.weight)[:, beside], 0)
    assert np.all(np.asarray(found.weight)[:, 2:5] > 0)


def surfaces(shape=(24, 30)):
    """Two slanted planes with a step between them."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    return jnp.asarray(np.where(x > 14, 1 + 0.01 * y, 0.008 * x))


def test_planes_and_steps_do_not_bend():
    truth = surfaces()
    assert float(bending(truth, truth, Bending())) < 1e-9
    crossed = bending(truth, jnp.zeros_like(truth), Bending())
    assert float(crossed) > 1000
    # A steep slant is no step: its noise counts.
    slant = 0.06 * jnp.arange(20.0)[None] + jnp.zeros((9, 1))
    noisy = slant + 0.004 * jax.random.normal(jax.random.key(3), slant.shape)
    assert float(bending(noisy, noisy, Bending())) > 100


def test_gradient_of_bending_and_one_trace():
    guide = surfaces((9, 20))
    rough = guide + 0.003 * jax.random.normal(jax.random.key(1), guide.shape)
    check_gradient(
        lambda d: bending(d, guide, Bending()), rough, rtol=1e-6, step=1e-7,
        directions=2, key=jax.random.key(2),
    )  # fmt: skip
    traced, traces = count_traces(lambda d, p: polish(d, p, iterations=3))
    single = traced(rough.astype(jnp.float32), Bending())
    assert single.dtype == jnp.float32
    traced(guide.astype(jnp.float32), Bending(weight=jnp.asarray(1.0)))
    assert traces() == 1


def test_in_derivatives_the_change_is_a_constant():
    rough = surfaces((7, 20)).at[2, 4].add(0.002)

    def loss(disparity, params):
        return jnp.sum(jnp.sin(40 * polish(disparity, params)))

    of_map, of_params = jax.jit(jax.grad(loss, (0, 1)))(rough, Bending())
    assert_allclose(of_map, 40 * jnp.cos(40 * polish(rough, Bending())), rtol=1e-9)
    assert all(float(leaf) == 0 for leaf in jax.tree.leaves(of_params))
    _, forward = jax.jvp(polish, (rough, Bending()), (rough, Bending()))
    assert_array_equal(forward, rough)


NARROW = Renderer.on_raster(1)
TRUE = 0.3


def plane(**known):
    """A textured plane, 5x5 views."""
    return LightField(plane_views(TRUE, size=SHAPE).views, **known)


def level(value, n=60):
    """Points everywhere that all say `value`, and the map of them."""
    xy = np.random.default_rng(1).uniform(0, [SHAPE[1] - 1, SHAPE[0] - 1], (n, 2))
    label = jnp.full(n, value)
    model = DepthModel(label, jnp.asarray(xy), 0 * label, jnp.zeros(SHAPE), jnp.ones(n, bool))
    return Start(model, jnp.full(n, 0.01), jnp.full(SHAPE, value))


@pytest.mark.slow
@pytest.mark.parametrize(
    "approach",
    [ByEvidence(), ByReprojection(subset=3, margin=jnp.asarray(0.01), rates=Rates.supervised())],
    ids=type,
)
def test_a_wrong_map_moves_towards_the_truth_that_is_not_read(approach):
    # Labels that are hardly known, so that nothing but the views holds them.
    start, told = level(TRUE + 0.02)._replace(error=jnp.full(60, 0.1)), []
    lie = GroundTruth(jnp.full(SHAPE, -5.0), jnp.ones(SHAPE, bool))
    routine = all_at_once(approach.rates, iterations=approach.iterations)
    found = optimize_edges(
        plane(truth=lie), start, approach, NARROW, routine=routine, progress=told.append,
        key=jax.random.key(2),
    )  # fmt: skip
    error = np.abs(np.asarray(found.disparity) - TRUE)[4:-4, 4:-4]
    assert error.max() < 0.01
    assert found.verdict is not None
    assert bool(found.verdict.kept)
    # The truth, too, has an error: views are interpolated linearly, and end.
    true = jnp.full(SHAPE, TRUE)
    least = explained(plane(), true, true, approach.features)[0]
    assert float(found.verdict.error[1] - least) < 0.1 * float(found.verdict.error[0] - least)
    assert (found.verdict.confirmed is not None) == isinstance(approach, ByEvidence)
    assert [now.iteration for now in told] == [approach.iterations * k // 4 for k in (1, 2, 3, 4)]
    assert all(now.grown is None for now in told)


@pytest.mark.parametrize("margin", [1.0, -jnp.inf])
def test_what_the_judges_do_not_confirm_is_dropped_and_the_first_map_polished(margin):
    ramp = jnp.broadcast_to(jnp.linspace(TRUE, TRUE + 0.05, SHAPE[1]), SHAPE)
    start = level(TRUE + 0.05)._replace(disparity=ramp)
    approach = ByReprojection(fit=None, margin=jnp.asarray(margin))
    found = optimize_edges(plane(), start, approach, NARROW)
    assert found.verdict is not None
    assert bool(found.verdict.kept) == (margin < 0)

    def rendered(model, guess):
        return render_model(model, NARROW, start=guess).disparity

    change = rendered(found.model, found.state.disparity) - rendered(start.model, ramp)
    assert float(jnp.abs(change).max()) > 2e-3
    kept = ramp + change if margin < 0 else ramp
    assert_allclose(found.disparity, polish(kept, Bending()), atol=1e-4)


def test_the_printed_objective_reads_all_views_and_keeps_what_it_finds():
    start = level(TRUE + 0.02)
    approach = ByReprojection.thesis()
    objective = approach.prepare(plane(), start, NARROW).objective
    assert isinstance(objective, SelfSupervised)
    assert objective.views.steps.shape == (8, 2)  # the crosshair of 5x5 views
    far = eqx.tree_at(lambda m: (m.disparity, m.xy), start.model, replace_fn=lambda x: x + 9.0)
    assert float(objective.trust.penalty(far)) == 0
    assert_allclose(objective.project(far).xy, far.xy)
    routine = one_at_a_time(approach.rates, passes=1)
    found = optimize_edges(plane(), start, approach, NARROW, routine=routine)
    assert found.history.loss.shape == (52,)  # 13 for each of four parameters
    assert found.verdict is not None
    assert bool(found.verdict.kept)
    best = render_model(found.model, NARROW, start=found.state.disparity).disparity
    assert_allclose(found.disparity, best, atol=1e-4)
    assert float(jnp.abs(best - TRUE).mean()) < 0.01


def test_bad_input_is_named():
    start = level(TRUE)._replace(disparity=jnp.zeros((3, 4)))
    with pytest.raises(ValueError, match=r"`start` has the shape \(3, 4\); the views have \(20"):
        optimize_edges(plane(), start, ByEvidence(), NARROW)
    for subset in (0, -5):
        with pytest.raises(ValueError, match=f"`subset` must be at least 1.* got {subset}"):
            ByReprojection(subset=subset)
