"""Optimization: its routines, what it keeps and skips, states in files, points that grow."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.peers.least_squares import minimise_least_squares, residuals_of
from mvedge_jax.losses import SupervisedWeights
from mvedge_jax.model import DepthModel, Renderer, render_model
from mvedge_jax.model._host import compiled_render
from mvedge_jax.model._model import with_capacity, without_free_places
from mvedge_jax.model.objectives import Supervised, Trust, unlimited
from mvedge_jax.model.optimisation import (
    FixedPoints,
    Growth,
    Rates,
    State,
    advance,
    all_at_once,
    begin,
    one_at_a_time,
    optimise,
)
from mvedge_jax.model.optimisation._grow import grow, usefulness, worst_pixels
from mvedge_jax.splatting import SplatLabels, SplatRaster, SplatWidths

SHAPE = (14, 18)
WIDE = Renderer(SplatLabels(SplatWidths(), SplatRaster(scale=1, lanes=16)))
# All tests take pieces of six iterations, which are one program.
SIXES = FixedPoints(piece=6)
RATES = Rates(rate=jnp.array([0.1, 0.03, 0.05, 0.05]))
TRUTH = jnp.zeros(SHAPE).at[4:10, 6:13].set(1.0)

loss_of = eqx.filter_jit(lambda goal, model, start: goal(model, start)[0])
rendered = eqx.filter_jit(lambda model: render_model(model, WIDE).disparity)


def start_model(n=30, capacity=None, seed=0):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, [SHAPE[1] - 1, SHAPE[0] - 1], (n, 2))
    at = np.round(xy).astype(int)
    label = np.asarray(TRUTH)[at[:, 1], at[:, 0]] + 0.1 * rng.normal(size=n)
    model = DepthModel(
        jnp.asarray(label), jnp.asarray(xy), jnp.zeros(n), jnp.zeros(SHAPE), jnp.ones(n, bool)
    )
    return model if capacity is None else with_capacity(model, capacity)


def objective(model, trust=None, renderer=WIDE):
    weights = SupervisedWeights(square=jnp.asarray(1.0))
    known = jnp.ones(SHAPE, bool)
    return Supervised(TRUTH, known, trust or unlimited(model), renderer, weights)


def first_state(model, seed=0):
    return begin(model, jnp.zeros(SHAPE), key=jax.random.key(seed))


def same(a, b):
    jax.tree.map(np.testing.assert_array_equal, a, b)


def test_both_routines_lower_the_loss_and_keep_the_best():
    model = start_model()
    goal = objective(model)
    for routine in (
        all_at_once(RATES, iterations=24),
        one_at_a_time(RATES, iterations=3, passes=2),
    ):
        state, history = optimise(first_state(model), routine, goal, strategy=SIXES)
        assert history.loss.shape == (24,)
        assert float(history.loss[-1]) < 0.8 * float(history.loss[0])
        best = loss_of(goal, state.best, state.disparity)
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
    same((state.model.xy, state.model.roughness), (model.xy, model.roughness))
    moved = jnp.abs(state.model.disparity - model.disparity)
    # a step of Adam is at most about one learning rate long
    assert 0.03 < float(moved.max()) <= 6 * 0.015 * 1.1


def test_stop_and_resume_give_the_same_as_going_on(tmp_path):
    model = start_model()
    goal, routine = objective(model), all_at_once(RATES, iterations=12)
    whole, _ = optimise(first_state(model), routine, goal, strategy=SIXES)
    half, _ = optimise(first_state(model), routine.part(0, 6), goal, strategy=SIXES)
    half.save(tmp_path / "state.eqx")
    again = State.load(tmp_path / "state.eqx")
    resumed, history = optimise(again, routine, goal, strategy=SIXES)
    assert history.loss.shape == (6,)
    same(whole.model, resumed.model)
    assert jax.tree.structure(again) == jax.tree.structure(half)
    same(jax.random.key_data(again.key), jax.random.key_data(half.key))


def test_states_that_are_none_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="no saved state"):
        State.load(tmp_path / "none.eqx")
    first_state(start_model()).save(tmp_path / "state.eqx")
    whole = (tmp_path / "state.eqx").read_bytes()
    for content in (whole[:-200], b"", b"\x93NUMPY", b"[3]\n" + whole):
        (tmp_path / "broken.eqx").write_bytes(content)
        with pytest.raises(ValueError, match=r"broken.eqx does not hold a whole state"):
            State.load(tmp_path / "broken.eqx")


def test_a_step_that_is_not_finite_is_skipped():
    model = start_model()
    goal = eqx.tree_at(lambda g: g.truth, objective(model), TRUTH.at[0, 0].set(jnp.nan))
    state, history = advance(first_state(model), all_at_once(RATES, iterations=6), goal)
    assert not bool(jnp.isfinite(history.loss).any())
    same(state.model, model)


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


def test_new_points_take_steps_of_the_learning_rate_however_late_they_come():
    model = start_model(26, capacity=30)
    routine, goal = all_at_once(RATES, iterations=60), objective(model)
    before, _ = optimise(first_state(model), routine.part(0, 48), goal, strategy=SIXES)
    wrong = jnp.abs(before.disparity - TRUTH)
    grown = grow(before, goal, wrong, TRUTH, Growth(), count=4)
    assert int(grown.added) == 4
    steps = []
    state = grown.state
    for at in range(48, 54):
        after, _ = advance(state, routine.part(at, at + 1), grown.objective)
        change = jnp.abs(after.model.xy - state.model.xy)[26:] / routine.rates[at, 3]
        steps.append(np.asarray(change))
        state = after
    assert 0.9 < steps[0].max() < 1.1
    assert np.max(steps) < 1.6
    for old, new in zip(before.moments.mu[1:], grown.state.moments.mu[1:], strict=True):
        np.testing.assert_array_equal(old[:26], new[:26])


def test_hidden_points_are_recycled_and_open_ones_are_not():
    model = start_model(4)
    xy = jnp.array([[3.0, 3.0], [3.1, 3.0], [12.0, 8.0], [5.0, 11.0]])
    label = jnp.array([1.0, 0.0, 0.5, 0.5])
    model = eqx.tree_at(lambda m: (m.xy, m.disparity), model, (xy, label))
    use = eqx.filter_jit(usefulness)(model, WIDE)
    assert float(use[1]) < 1e-3
    assert float(use[0]) > 0.5
    grown = grow(first_state(model), objective(model), TRUTH, TRUTH, Growth(), count=3)
    assert (int(grown.added), int(grown.recycled), int(grown.refused)) == (1, 1, 2)
    changed = np.flatnonzero(jnp.any(grown.state.model.xy != xy, axis=1))
    np.testing.assert_array_equal(changed, [1])


def test_worst_pixels_are_one_per_block_in_order():
    residual = jnp.zeros((5, 7)).at[4, 6].set(3.0).at[0, 0].set(2.0).at[1, 1].set(1.9)
    xy, value = worst_pixels(residual, 2)
    np.testing.assert_array_equal(xy, [[6, 4], [0, 0]])
    np.testing.assert_array_equal(value, [3, 2])


def test_free_places_leave_and_points_keep_their_order():
    model = start_model(6, capacity=9)
    model = eqx.tree_at(lambda m: m.valid, model, model.valid.at[2].set(False))
    dense = without_free_places(model)
    np.testing.assert_array_equal(dense.xy, model.xy[jnp.array([0, 1, 3, 4, 5])])
    assert bool(dense.valid.all())
    np.testing.assert_allclose(rendered(model), rendered(dense), atol=1e-6)
    assert Growth(extra=4).prepare(model).valid.tolist() == 5 * [True] + 4 * [False]


def one_sided_model():
    """Points on the far plane alone, each with a hidden twin: none tells of the near square."""
    model = start_model(40)
    behind = np.asarray(TRUTH)[tuple(np.round(model.xy).astype(int).T[::-1])] == 0
    xy, nothing = model.xy[behind], jnp.zeros(int(behind.sum()))
    twins = jnp.concatenate([nothing, nothing - 0.5])
    both = jnp.concatenate([xy, xy])
    return DepthModel(twins, both, 0 * twins, model.roughness, jnp.ones(twins.size, bool))


@pytest.mark.parametrize(
    ("until", "iterations", "rounds"), [(0.6, 30, 3), (0.0, 6, 0), (1.0, 18, 2)]
)
def test_growing_moves_points_to_what_no_gradient_reaches(until, iterations, rounds):
    """And none after the last iteration, as they could not be optimized."""
    model = one_sided_model()
    goal = objective(model, renderer=Renderer.on_raster(1))
    routine, told = all_at_once(RATES, iterations=iterations), []
    strategy = Growth(rounds=3, until=jnp.asarray(until))
    grown, history = optimise(
        first_state(model), routine, goal, strategy=strategy, progress=told.append
    )
    assert [now.iteration for now in told] == list(range(6, iterations + 1, 6))
    assert {now.iterations for now in told} == {iterations}
    assert history.loss.shape == (iterations,)
    assert told[-1].loss == float(history.loss[-1])
    assert float(grown.best_loss) <= float(history.loss[-1])
    found = [now.grown for now in told if now.grown is not None]
    assert len(found) == rounds
    assert int(grown.best.valid.sum()) == model.valid.size
    if rounds == 3:
        assert int(found[0].recycled) > 0
        alone, _ = optimise(first_state(model), routine, goal, strategy=SIXES)
        assert float(grown.best_loss) < 0.5 * float(alone.best_loss)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: FixedPoints(piece=0), "`piece` must be at least 1 iteration, got 0"),
        (lambda: Growth(rounds=0), "`rounds` and `count` must be at least 1, got 0 and None"),
        (lambda: Growth(count=0), "`rounds` and `count` must be at least 1, got 9 and 0"),
        (lambda: Growth(extra=-1), "`extra` must not be negative, got -1"),
        (lambda: Growth(until=jnp.asarray(1.5)), "`until` must be a share from 0 to 1, got 1.5"),
        (lambda: with_capacity(start_model(), 3), "`capacity` is 3, but the model has 30 places"),
    ],
)
def test_what_is_no_schedule_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_growing_needs_a_known_map_and_does_nothing_where_nothing_may_change():
    class Unknown(eqx.Module):
        def __call__(self, model, start, *, key):
            return jnp.zeros(()), start

        def project(self, model):
            return model

    model, routine = start_model(), all_at_once(RATES, iterations=8)
    with pytest.raises(ValueError, match="needs a known map.*the objective is Unknown"):
        optimise(first_state(model), routine, Unknown(), strategy=Growth())
    idle = Growth(recycle=False).plan(first_state(model), routine, objective(model))
    assert (idle.piece, idle.last) == (2, -1)


@pytest.mark.parametrize(
    ("absolute", "square", "blunt"),
    [(0.0, 0.0, 0.01), (0.0, 2.0, 0.01), (1.0, 1.0, 0.01), (1.0, 1.0, 1e-4)],
)
def test_the_residuals_are_the_roots_of_the_loss(absolute, square, blunt):
    """Absolute errors are blunted by a hundredth of a pixel, or what is asked for."""
    model = start_model()
    trust = Trust(model, jnp.full(30, 0.05), jnp.asarray(0.3))
    moved = eqx.tree_at(lambda m: m.disparity, model, model.disparity + 0.2)
    weights = SupervisedWeights(absolute=jnp.asarray(absolute), square=jnp.asarray(square))
    goal = eqx.tree_at(lambda g: g.weights, objective(model, trust), weights)
    residuals = eqx.filter_jit(lambda g: residuals_of(g, moved, TRUTH, blunt=blunt)[0])(goal)
    half = sum(float(jnp.sum(r**2)) for r in residuals) / 2
    loss = float(loss_of(goal, moved, TRUTH))
    if absolute:
        assert 0.01 * blunt < loss - half < blunt
    else:
        assert half == pytest.approx(loss, rel=1e-6)


@pytest.mark.slow
def test_levenberg_marquardt_needs_few_steps():
    model = start_model()
    goal = objective(model)
    adam, _ = optimise(first_state(model), all_at_once(RATES, iterations=24), goal, strategy=SIXES)
    seen = []
    found = minimise_least_squares(
        model, goal, jnp.zeros(SHAPE), steps=6, progress=lambda *now: seen.append(now)
    )
    assert float(found.loss.min()) < float(adam.best_loss)
    best = loss_of(goal, found.model, found.disparity)
    assert float(best) == pytest.approx(float(found.loss.min()), rel=1e-3)
    assert [loss for _, loss in seen] == pytest.approx(found.loss[1:].tolist())
    with pytest.raises(ValueError, match="`steps` must be at least 1, got 0"):
        minimise_least_squares(model, goal, jnp.zeros(SHAPE), steps=0)


def test_points_that_are_cut_off_are_warned_of():
    """Inside the compiled loop nothing can be said, so the host says it before."""
    model = start_model()
    nothing = all_at_once(RATES, iterations=0)
    few = Renderer(SplatLabels(SplatWidths(), SplatRaster(scale=1, lanes=16, capacity=2)))
    wide, both = (
        eqx.tree_at(lambda r: r.splat.widths.sigma_label, renderer, jnp.asarray(4.0))
        for renderer in (WIDE, few)
    )
    message = "Points of `sigma_label` = 4 px still count .* at `radius` = 6 px"
    with pytest.warns(UserWarning, match=message):
        optimise(first_state(model), nothing, objective(model, renderer=wide))
    with pytest.raises(UserWarning, match=message):  # warnings are errors here
        minimise_least_squares(model, objective(model, renderer=wide), jnp.zeros(SHAPE))
    full = "entries of the tiles' lists exceed `SplatRaster.capacity`"
    with pytest.warns(UserWarning, match=full):
        optimise(first_state(model), nothing, objective(model, renderer=few))
    problems = eqx.filter_jit(render_model)(model, both).problems()
    assert ["`SplatRaster.radius`" in line for line in problems] == [True, False]
    with pytest.warns(UserWarning, match="SplatRaster") as said:
        compiled_render(model, both)
    assert tuple(str(warning.message) for warning in said) == problems
