"""Fits to a known map: the loop with its defaults, points that are added, states that go on."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mvedge_jax.lightfield import GroundTruth
from mvedge_jax.model import DepthModel, Renderer, Start, SupervisedFit, fit_edges, render_model
from mvedge_jax.model._model import with_capacity
from mvedge_jax.model.objectives import Supervised, unlimited
from mvedge_jax.model.optimisation import (
    FixedPoints,
    Growth,
    Rates,
    State,
    Strategy,
    advance,
    all_at_once,
    begin,
)

SHAPE = (14, 18)
NARROW = Renderer.on_raster(1)
KNOWN = GroundTruth(jnp.zeros(SHAPE).at[4:10, 6:13].set(1.0), jnp.ones(SHAPE, bool))
# Seventy places and pieces of two iterations, which are one program.
GROWING = Growth(recycle=False, extra=40, rounds=3, threshold=jnp.asarray(0.0))


def noisy_start(n=30, seed=0):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, [SHAPE[1] - 1, SHAPE[0] - 1], (n, 2))
    column, row = np.round(xy).astype(int).T
    label = jnp.asarray(np.asarray(KNOWN.disparity)[row, column] + 0.1 * rng.normal(size=n))
    model = DepthModel(label, jnp.asarray(xy), 0 * label, jnp.zeros(SHAPE), jnp.ones(n, bool))
    return Start(model, jnp.full(n, jnp.inf), jnp.zeros(SHAPE))


def fitted(start=None, known=KNOWN, *, iterations=10, strategy: Strategy = GROWING, **options):
    start = noisy_start() if start is None else start
    table = all_at_once(Rates.supervised(), iterations=iterations)
    return fit_edges(
        known, start, SupervisedFit(), NARROW, strategy=strategy, routine=table, **options
    )


def same(a, b):
    jax.tree.map(np.testing.assert_array_equal, a, b)


def test_fitting_is_the_loop_with_the_defaults_that_are_written_down():
    start = noisy_start()
    found = fit_edges(KNOWN, start, SupervisedFit(), NARROW, strategy=FixedPoints())
    goal = Supervised(KNOWN.disparity, KNOWN.valid, unlimited(start.model), NARROW)
    assert float(goal.weights.square) == 3
    state = begin(start.model, start.disparity, key=jax.random.key(0))
    table = all_at_once(Rates.supervised(), iterations=40)
    for at in range(0, 40, 10):
        state, _ = advance(state, table.part(at, at + 10), goal)
    same(found.model, state.best)
    assert found.history.loss.shape == (40,)
    assert found.verdict is None
    rendered = eqx.filter_jit(render_model)(state.best, NARROW).disparity
    np.testing.assert_allclose(found.disparity, rendered, atol=1e-4)
    assert float(found.history.loss[-1]) < 0.5 * float(found.history.loss[0])


def test_free_places_leave_and_are_filled_in_time():
    """Rounds are evenly spaced, so that there may be fewer than `rounds`: here two of three."""
    start, told = noisy_start(), []
    roomy = start._replace(model=with_capacity(start.model, 33), error=jnp.pad(start.error, (0, 3)))
    found = fitted(roomy, iterations=6, progress=told.append)
    assert found.model.valid.tolist() == 70 * [True]
    rounds = [now.grown for now in told if now.grown is not None]
    assert [(int(g.added), int(g.recycled)) for g in rounds] == [(20, 0), (20, 0)]


@pytest.mark.parametrize("recycle", [False, True])
def test_a_state_from_between_two_rounds_goes_on_the_same(recycle, tmp_path):
    growth, told = replace(GROWING, recycle=recycle), []
    whole = fitted(strategy=growth, progress=told.append)
    assert whole.model.valid.sum() == 70
    # The first of three rounds is over.
    told[0].state.save(tmp_path / "part.eqx")
    resumed = fitted(strategy=growth, state=State.load(tmp_path / "part.eqx"))
    assert resumed.history.loss.shape == (8,)
    same(whole.model, resumed.model)
    with pytest.raises(ValueError, match="`state` has 70 points .*; the start has 30 points"):
        fitted(strategy=FixedPoints(), state=told[0].state)


def test_a_map_of_another_shape_is_refused():
    small = GroundTruth(jnp.zeros((3, 4)), jnp.ones((3, 4), bool))
    with pytest.raises(ValueError, match=r"`truth` has the shape \(3, 4\); the map of `start`"):
        fitted(known=small)


def test_unknown_pixels_have_no_say():
    valid = KNOWN.valid.at[0, 0].set(False)
    truths = (KNOWN.disparity.at[0, 0].set(value) for value in (0.0, 9.0))
    maps = [fitted(known=GroundTruth(truth, valid), iterations=6).disparity for truth in truths]
    np.testing.assert_array_equal(maps[0], maps[1])


def test_rounds_without_a_new_point_forget_nothing():
    start = noisy_start()
    label = 0 * start.model.disparity + 0.5
    exact = start._replace(model=eqx.tree_at(lambda m: m.disparity, start.model, label))
    known = GroundTruth(0 * KNOWN.disparity + 0.5, KNOWN.valid)
    found = fitted(exact, known, strategy=Growth(extra=40, rounds=3))
    np.testing.assert_allclose(found.disparity, 0.5, atol=1e-6)
