import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mvedge_jax.losses import SupervisedWeights
from mvedge_jax.reconstruct import (
    DepthModel,
    ModelParams,
    ModelSizes,
    Rates,
    Supervised,
    Trust,
    advance,
    all_at_once,
    begin,
    grow,
    load_state,
    minimise_lbfgs,
    one_at_a_time,
    optimise,
    render_model,
    save_state,
    unlimited,
    usefulness,
    with_capacity,
    worst_pixels,
)
from mvedge_jax.splatting import SplatSizes

SHAPE = (14, 18)
SIZES = ModelSizes(splat=SplatSizes(scale=1, lanes=16))
RATES = Rates(rate=jnp.array([0.1, 0.03, 0.05, 0.05]))


def truth():
    return jnp.zeros(SHAPE).at[4:10, 6:13].set(1.0)


def start_model(n=30, capacity=None, seed=0):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, [SHAPE[1] - 1, SHAPE[0] - 1], (n, 2))
    at = np.round(xy).astype(int)
    label = np.asarray(truth())[at[:, 1], at[:, 0]] + 0.1 * rng.normal(size=n)
    model = DepthModel(
        jnp.asarray(label), jnp.asarray(xy), jnp.zeros(n), jnp.zeros(SHAPE), jnp.ones(n, bool)
    )
    return model if capacity is None else with_capacity(model, capacity)


def objective(model, trust=None):
    weights = SupervisedWeights(square=jnp.asarray(1.0))
    known = jnp.ones(SHAPE, bool)
    return Supervised(truth(), known, trust or unlimited(model), weights=weights, sizes=SIZES)


def first_state(model, seed=0):
    return begin(model, jnp.zeros(SHAPE), key=jax.random.key(seed))


def test_both_routines_lower_the_loss_and_keep_the_best():
    model = start_model()
    goal = objective(model)
    for routine in (
        all_at_once(RATES, iterations=24),
        one_at_a_time(RATES, iterations=3, passes=2),
    ):
        state, history = optimise(first_state(model), routine, goal, chunk=6)
        assert history.loss.shape == (24,)
        assert float(history.loss[-1]) < 0.8 * float(history.loss[0])
        best = goal(state.best, state.disparity)[0]
        assert float(state.best_loss) == pytest.approx(float(history.loss.min()))
        assert float(best) == pytest.approx(float(state.best_loss), rel=1e-3)


def test_one_at_a_time_moves_one_at_a_time():
    routine = one_at_a_time(Rates(), iterations=6, passes=2)
    assert routine.length == 48
    np.testing.assert_array_equal(jnp.sum(routine.rates > 0, axis=1), 1)
    np.testing.assert_array_equal(jnp.argmax(routine.rates[:24:6], axis=1), [0, 1, 2, 3])
    np.testing.assert_allclose(routine.rates[24:].max(0) / routine.rates[:24].max(0), Rates().decay)
    np.testing.assert_array_equal(routine.restart, ([True] + 5 * [False]) * 8)
    model = start_model()
    state, _ = advance(first_state(model), routine.part(6, 12), objective(model))
    np.testing.assert_array_equal(state.model.xy, model.xy)
    np.testing.assert_array_equal(state.model.roughness, model.roughness)
    moved = jnp.abs(state.model.disparity - model.disparity)
    # a step of Adam is at most about one learning rate long
    assert 0.03 < float(moved.max()) <= 6 * 0.015 * 1.1


def test_stop_and_resume_give_the_same_as_going_on(tmp_path):
    model = start_model()
    goal, routine = objective(model), all_at_once(RATES, iterations=12)
    whole, _ = optimise(first_state(model), routine, goal, chunk=6)
    half, _ = optimise(first_state(model), routine.part(0, 6), goal, chunk=6)
    save_state(tmp_path / "state.eqx", half)
    again = load_state(tmp_path / "state.eqx", first_state(model, seed=5))
    resumed, history = optimise(again, routine, goal, chunk=6)
    assert history.loss.shape == (6,)
    for a, b in zip(jax.tree.leaves(whole.model), jax.tree.leaves(resumed.model), strict=True):
        np.testing.assert_array_equal(a, b)
    with pytest.raises(FileNotFoundError, match="no saved state"):
        load_state(tmp_path / "none.eqx", half)
    with pytest.raises(ValueError, match="does not hold a state of 31 points"):
        load_state(tmp_path / "state.eqx", first_state(start_model(31)))
    with pytest.raises(ValueError, match="`chunk` must be at least 1"):
        optimise(half, routine, goal, chunk=0)


def test_a_step_that_is_not_finite_is_skipped():
    model = start_model()
    goal = eqx.tree_at(lambda g: g.truth, objective(model), truth().at[0, 0].set(jnp.nan))
    state, history = advance(first_state(model), all_at_once(RATES, iterations=12).part(0, 6), goal)
    assert not bool(jnp.isfinite(history.loss).any())
    for a, b in zip(jax.tree.leaves(state.model), jax.tree.leaves(model), strict=True):
        np.testing.assert_array_equal(a, b)


def test_trust_limits_and_pulls_back():
    model = start_model()
    trust = Trust(model, jnp.full(30, 0.01), label=jnp.asarray(0.02), position=jnp.asarray(0.5))
    far = eqx.tree_at(
        lambda m: (m.disparity, m.xy, m.log_weight, m.roughness),
        model,
        (model.disparity + 1, model.xy - 3, model.log_weight + 99, model.roughness + 99),
    )
    near = trust.project(far)
    np.testing.assert_allclose(near.disparity - model.disparity, 0.02, atol=1e-12)
    np.testing.assert_allclose(near.xy - model.xy, -0.5, atol=1e-12)
    assert float(near.log_weight.max()) == 8
    assert float(near.roughness.max()) == 14
    heavy = eqx.tree_at(lambda t: t.weight, trust, jnp.asarray(2.0))
    assert float(heavy.penalty(model)) == 0
    assert float(heavy.penalty(near)) == pytest.approx(2 * np.log1p(4))


@pytest.mark.slow
def test_new_points_go_where_the_residual_is_largest():
    model = start_model(30, capacity=34)
    state, goal = first_state(model), objective(model)
    disparity = render_model(model, goal.params, SIZES).disparity
    # Only on the nearer surface: a new point of the farther one, beside it, would be hidden.
    residual = jnp.where(truth() == 1, jnp.abs(disparity - truth()), 0)
    grown = grow(state, goal, residual, truth(), count=3)
    assert (int(grown.added), int(grown.recycled), int(grown.refused)) == (3, 0, 0)
    new = np.flatnonzero(grown.state.model.valid & ~model.valid)
    xy, _ = worst_pixels(residual, 3)
    assert {tuple(p) for p in np.asarray(grown.state.model.xy)[new]} == {
        tuple(p) for p in np.asarray(xy, float)
    }
    after = render_model(grown.state.model, goal.params, SIZES).disparity
    at = xy[:, 1], xy[:, 0]
    assert bool(jnp.all(jnp.abs(after - truth())[at] < residual[at] * 2 / 3))
    np.testing.assert_array_equal(grown.objective.trust.origin.xy, grown.state.model.xy)


def test_new_points_take_steps_of_the_learning_rate_however_late_they_come():
    model = start_model(10, capacity=14)
    routine = all_at_once(RATES, iterations=60)
    before, _ = advance(first_state(model), routine.part(0, 50), objective(model))
    grown = grow(before, objective(model), jnp.abs(before.disparity - truth()), truth(), count=4)
    assert int(grown.added) == 4
    steps = []
    state = grown.state
    for at in range(50, 56):
        after, _ = advance(state, routine.part(at, at + 1), grown.objective)
        change = jnp.abs(after.model.xy - state.model.xy)[10:] / routine.rates[at, 3]
        steps.append(np.asarray(change))
        state = after
    assert 0.9 < steps[0].max() < 1.1
    assert np.max(steps) < 1.6
    for old, new in zip(before.moments.mu[1:], grown.state.moments.mu[1:], strict=True):
        np.testing.assert_array_equal(old[:10], new[:10])


def test_hidden_points_are_recycled_and_open_ones_are_not():
    model = start_model(4)
    xy = jnp.array([[3.0, 3.0], [3.1, 3.0], [12.0, 8.0], [5.0, 11.0]])
    label = jnp.array([1.0, 0.0, 0.5, 0.5])
    model = eqx.tree_at(lambda m: (m.xy, m.disparity), model, (xy, label))
    use = usefulness(model, ModelParams(), SIZES)
    assert float(use[1]) < 1e-3
    assert float(use[0]) > 0.5
    grown = grow(first_state(model), objective(model), truth(), truth(), count=3)
    assert (int(grown.added), int(grown.recycled), int(grown.refused)) == (1, 1, 2)
    changed = np.flatnonzero(jnp.any(grown.state.model.xy != xy, axis=1))
    np.testing.assert_array_equal(changed, [1])


def test_worst_pixels_are_one_per_block_in_order():
    residual = jnp.zeros((5, 7)).at[4, 6].set(3.0).at[0, 0].set(2.0).at[1, 1].set(1.9)
    xy, value = worst_pixels(residual, 2)
    np.testing.assert_array_equal(xy, [[6, 4], [0, 0]])
    np.testing.assert_array_equal(value, [3, 2])


def test_capacity_never_shrinks():
    with pytest.raises(ValueError, match="`capacity` is 3, but the model has 30 places"):
        with_capacity(start_model(30), 3)


@pytest.mark.slow
def test_lbfgs_lowers_the_loss():
    model = start_model()
    goal = objective(model)
    found = minimise_lbfgs(model, goal, steps=12)
    assert float(found.loss[1]) < 0.7 * float(found.loss[0])
