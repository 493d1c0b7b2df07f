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
SIXES = FixedPoints(piece=6)
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
    return Supervised(truth(), known, trust or unlimited(model), WIDE, weights)


def first_state(model, seed=0):
    return begin(model, jnp.zeros(SHAPE), key=jax.random.key(seed))


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
    whole, _ = optimise(first_state(model), routine, goal, strategy=SIXES)
    half, _ = optimise(first_state(model), routine.part(0, 6), goal, strategy=SIXES)
    half.save(tmp_path / "state.eqx")
    again = State.load(tmp_path / "state.eqx")
    resumed, history = optimise(again, routine, goal, strategy=SIXES)
    assert history.loss.shape == (6,)
    for a, b in zip(jax.tree.leaves(whole.model), jax.tree.leaves(resumed.model), strict=True):
        np.testing.assert_array_equal(a, b)
    assert jax.tree.structure(again) == jax.tree.structure(half)
    np.testing.assert_array_equal(jax.random.key_data(again.key), jax.random.key_data(half.key))


def test_states_that_are_none_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="no saved state"):
        State.load(tmp_path / "none.eqx")
    first_state(start_model()).save(tmp_path / "state.eqx")
    whole = (tmp_path / "state.eqx").read_bytes()
    for content in (whole[:-200], b"", b"\x93NUMPY", b"[3]\n" + whole):
        (tmp_path / "broken.eqx").write_bytes(content)
        with pytest.raises(ValueError, match=r"broken.eqx does not hold a whole state"):
            State.load(tmp_path / "broken.eqx")


def test_pieces_have_an_iteration_at_least():
    with pytest.raises(ValueError, match="`piece` must be at least 1 iteration, got 0"):
        FixedPoints(piece=0)


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
    disparity = render_model(model, WIDE).disparity
    # Only on the nearer surface: a new point of the farther one, beside it, would be hidden.
    residual = jnp.where(truth() == 1, jnp.abs(disparity - truth()), 0)
    grown = grow(state, goal, residual, truth(), Growth(), count=3)
    assert (int(grown.added), int(grown.recycled), int(grown.refused)) == (3, 0, 0)
    new = np.flatnonzero(grown.state.model.valid & ~model.valid)
    xy, _ = worst_pixels(residual, 3)
    assert {tuple(p) for p in np.asarray(grown.state.model.xy)[new]} == {
        tuple(p) for p in np.asarray(xy, float)
    }
    after = render_model(grown.state.model, WIDE).disparity
    at = xy[:, 1], xy[:, 0]
    assert bool(jnp.all(jnp.abs(after - truth())[at] < residual[at] * 2 / 3))
    assert isinstance(grown.objective, Supervised)
    np.testing.assert_array_equal(grown.objective.trust.origin.xy, grown.state.model.xy)


def test_new_points_take_steps_of_the_learning_rate_however_late_they_come():
    model = start_model(10, capacity=14)
    routine = all_at_once(RATES, iterations=60)
    before, _ = advance(first_state(model), routine.part(0, 50), objective(model))
    wrong = jnp.abs(before.disparity - truth())
    grown = grow(before, objective(model), wrong, truth(), Growth(), count=4)
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
    use = usefulness(model, WIDE)
    assert float(use[1]) < 1e-3
    assert float(use[0]) > 0.5
    grown = grow(first_state(model), objective(model), truth(), truth(), Growth(), count=3)
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


def test_free_places_leave_and_points_keep_their_order():
    model = start_model(6, capacity=9)
    model = eqx.tree_at(lambda m: m.valid, model, model.valid.at[2].set(False))
    dense = without_free_places(model)
    np.testing.assert_array_equal(dense.xy, model.xy[jnp.array([0, 1, 3, 4, 5])])
    assert bool(dense.valid.all())
    maps = [render_model(m, WIDE).disparity for m in (model, dense)]
    np.testing.assert_allclose(maps[0], maps[1], atol=1e-6)


def one_sided_model():
    """Points on the far plane alone, each with a hidden twin: none tells of the near square."""
    model = start_model(40)
    behind = jnp.asarray(np.asarray(truth())[tuple(np.round(model.xy).astype(int).T[::-1])] == 0)
    model = eqx.tree_at(lambda m: (m.valid, m.disparity), model, (behind, 0 * model.disparity))
    model = without_free_places(model)
    twins = DepthModel(
        jnp.concatenate([model.disparity, model.disparity - 0.5]),
        jnp.concatenate([model.xy, model.xy]),
        jnp.concatenate([model.log_weight, model.log_weight]),
        model.roughness,
        jnp.concatenate([model.valid, model.valid]),
    )
    return twins


def test_growing_moves_points_to_what_no_gradient_reaches():
    model = one_sided_model()
    narrow = SplatLabels.on_raster(1).widths
    goal = eqx.tree_at(lambda g: g.renderer.splat.widths, objective(model), narrow)
    routine = all_at_once(RATES, iterations=30)
    told = []
    strategy = Growth(rounds=3)
    grown, history = optimise(
        first_state(model), routine, goal, strategy=strategy, progress=told.append
    )
    alone, _ = optimise(first_state(model), routine, goal, strategy=SIXES)
    assert [now.iteration for now in told] == [6, 12, 18, 24, 30]
    assert {now.iterations for now in told} == {30}
    assert told[1].loss == float(history.loss[11])
    rounds = [now.grown for now in told if now.grown is not None]
    assert history.loss.shape == (30,)
    assert len(rounds) == 3
    assert int(rounds[0].recycled) > 0
    assert int(grown.best.valid.sum()) == model.valid.size
    assert float(grown.best_loss) < 0.5 * float(alone.best_loss)


def test_growing_without_recycling_fills_free_places_only():
    model = with_capacity(one_sided_model(), 90)
    free = 90 - int(model.valid.sum())
    told = []
    keep = Growth(recycle=False)
    routine = all_at_once(RATES, iterations=10)
    state, _ = optimise(
        first_state(model), routine, objective(model), strategy=keep, progress=told.append
    )
    rounds = [now.grown for now in told if now.grown is not None]
    assert sum(int(grown.added) for grown in rounds) == free
    assert all(int(grown.recycled) == 0 for grown in rounds)
    assert bool(state.model.valid.all())


@pytest.mark.parametrize(("until", "expected"), [(0.0, 0), (1.0, 3)])
def test_no_points_grow_after_the_last_iteration(until, expected):
    model = one_sided_model()
    told = []
    state, history = optimise(
        first_state(model),
        all_at_once(RATES, iterations=4),
        objective(model),
        strategy=Growth(until=jnp.asarray(until)),
        progress=told.append,
    )
    assert sum(now.grown is not None for now in told) == expected
    assert float(state.best_loss) <= float(history.loss[-1])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rounds": 0}, "`rounds` and `count` must be at least 1, got 0 and None"),
        ({"count": 0}, "`rounds` and `count` must be at least 1, got 9 and 0"),
        ({"extra": -1}, "`extra` must not be negative, got -1"),
        ({"until": jnp.asarray(1.5)}, "`until` must be a share from 0 to 1, got 1.5"),
    ],
)
def test_growing_rejects_what_is_no_schedule(options, message):
    with pytest.raises(ValueError, match=message):
        Growth(**options)


def test_growing_needs_a_known_map():
    model = start_model()

    class Unknown(eqx.Module):
        def __call__(self, model, start, *, key):
            return jnp.zeros(()), start

        def project(self, model):
            return model

    routine = all_at_once(RATES, iterations=2)
    with pytest.raises(ValueError, match="needs a known map.*the objective is Unknown"):
        optimise(first_state(model), routine, Unknown(), strategy=Growth())


def test_a_strategy_makes_room_and_does_nothing_where_nothing_may_change():
    model = eqx.tree_at(lambda m: m.valid, start_model(6), jnp.arange(6) != 2)
    assert Growth(extra=4).prepare(model).valid.tolist() == 5 * [True] + 4 * [False]
    full, routine = start_model(), all_at_once(RATES, iterations=8)
    idle = Growth(recycle=False).plan(first_state(full), routine, objective(full))
    assert (idle.piece, idle.last) == (2, -1)


def test_the_residuals_are_the_roots_of_the_loss():
    model = start_model()
    trust = Trust(model, jnp.full(30, 0.05), jnp.asarray(0.3))
    moved = eqx.tree_at(lambda m: m.disparity, model, model.disparity + 0.2)
    for square in (0.0, 2.0):
        weights = SupervisedWeights(absolute=jnp.asarray(0.0), square=jnp.asarray(square))
        goal = Supervised(truth(), jnp.ones(SHAPE, bool), trust, WIDE, weights)
        residuals, _ = residuals_of(goal, moved, truth())
        half = sum(float(jnp.sum(r**2)) for r in residuals) / 2
        assert half == pytest.approx(float(goal(moved, truth())[0]), rel=1e-6)
    # Absolute errors are blunted by a hundredth of a pixel, or what is asked for.
    goal = objective(moved)
    for blunt in (0.01, 1e-4):
        residuals, _ = residuals_of(goal, moved, truth(), blunt=blunt)
        half = sum(float(jnp.sum(r**2)) for r in residuals) / 2
        assert 0.01 * blunt < float(goal(moved, truth())[0]) - half < blunt


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
    best = goal(found.model, found.disparity)[0]
    assert float(best) == pytest.approx(float(found.loss.min()), rel=1e-3)
    assert [loss for _, loss in seen] == pytest.approx(found.loss[1:].tolist())
    with pytest.raises(ValueError, match="`steps` must be at least 1, got 0"):
        minimise_least_squares(model, goal, jnp.zeros(SHAPE), steps=0)


def test_points_that_are_cut_off_are_warned_of():
    """Inside the compiled loop nothing can be said, so the host says it before."""
    model = start_model()
    goal = objective(model)
    wide = eqx.tree_at(lambda r: r.splat.widths.sigma_label, goal.renderer, jnp.asarray(4.0))
    goal = eqx.tree_at(lambda g: g.renderer, goal, wide)
    message = "Points of `sigma_label` = 4 px still count .* at `radius` = 6 px"
    nothing = all_at_once(RATES, iterations=0)
    with pytest.warns(UserWarning, match=message):
        optimise(first_state(model), nothing, goal)
    with pytest.raises(UserWarning, match=message):  # warnings are errors here
        minimise_least_squares(model, goal, jnp.zeros(SHAPE))
    few = Renderer(SplatLabels(SplatWidths(), SplatRaster(scale=1, lanes=16, capacity=2)))
    goal = Supervised(truth(), jnp.ones(SHAPE, bool), unlimited(model), renderer=few)
    full = "entries of the tiles' lists exceed `SplatRaster.capacity`"
    with pytest.warns(UserWarning, match=full):
        optimise(first_state(model), nothing, goal)
    with pytest.warns(UserWarning, match=full):
        render_model(model, few)
    both = eqx.tree_at(lambda r: r.splat.widths.sigma_label, few, jnp.asarray(4.0))
    rendered = eqx.filter_jit(render_model)(model, both)
    assert ["`SplatRaster.radius`" in line for line in rendered.problems()] == [True, False]
    with pytest.warns(UserWarning, match="SplatRaster") as said:
        compiled_render(model, both)
    assert tuple(str(warning.message) for warning in said) == rendered.problems()
