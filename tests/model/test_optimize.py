"""Optimization and fits: what is kept and skipped, states in files, points that grow."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.peers.least_squares import minimize_least_squares, residuals_of
from mvedge_jax.lightfield import GroundTruth
from mvedge_jax.losses import SupervisedWeights
from mvedge_jax.model import DepthModel, Renderer, Start, SupervisedFit, fit_edges, render_model
from mvedge_jax.model._host import compiled_render
from mvedge_jax.model._model import with_capacity
from mvedge_jax.model.objectives import Supervised, Trust, unlimited
from mvedge_jax.model.optimization import (
    FixedPoints,
    Growth,
    Rates,
    State,
    Strategy,
    advance,
    all_at_once,
    begin,
    one_at_a_time,
    optimize,
)
from mvedge_jax.model.optimization._grow import grow, usefulness
from mvedge_jax.splatting import SplatLabels, SplatRaster, SplatWidths

SHAPE = (14, 18)
WIDE = Renderer(SplatLabels(SplatWidths(), SplatRaster(scale=1, lanes=16)))
# All tests take pieces of six iterations, which are one program.
SIXES = FixedPoints(piece=6)
RATES = Rates(rate=jnp.array([0.1, 0.03, 0.05, 0.05]))
TRUTH = jnp.zeros(SHAPE).at[4:10, 6:13].set(1.0)

loss_of = eqx.filter_jit(lambda goal, model, start: goal(model, start)[0])


def start_model(n=30):
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, [SHAPE[1] - 1, SHAPE[0] - 1], (n, 2))
    column, row = np.round(xy).astype(int).T
    label = jnp.asarray(np.asarray(TRUTH)[row, column] + 0.1 * rng.normal(size=n))
    return DepthModel(label, jnp.asarray(xy), 0 * label, jnp.zeros(SHAPE), jnp.ones(n, bool))


def objective(model, trust=None, renderer=WIDE):
    weights = SupervisedWeights(square=jnp.asarray(1.0))
    known = jnp.ones(SHAPE, bool)
    return Supervised(TRUTH, known, trust or unlimited(model), renderer, weights)


def first_state(model):
    return begin(model, jnp.zeros(SHAPE), key=jax.random.key(0))


def same(a, b):
    jax.tree.map(np.testing.assert_array_equal, a, b)


def test_both_routines_lower_the_loss_and_keep_the_best():
    model = start_model()
    goal = objective(model)
    for routine in (
        all_at_once(RATES, iterations=24),
        one_at_a_time(RATES, iterations=3, passes=2),
    ):
        state, history = optimize(first_state(model), routine, goal, strategy=SIXES)
        assert history.loss.shape == (24,)
        assert float(history.loss[-1]) < 0.8 * float(history.loss[0])
        best = loss_of(goal, state.best, state.disparity)
        assert float(state.best_loss) == pytest.approx(float(history.loss.min()))
        assert float(best) == pytest.approx(float(state.best_loss), rel=1e-3)


def test_states_come_back_from_files_and_what_is_none_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="no saved state"):
        State.load(tmp_path / "none.eqx")
    state = begin(start_model(), TRUTH, key=jax.random.key(7))
    state.save(tmp_path / "state.eqx")
    again = State.load(tmp_path / "state.eqx")
    assert jax.tree.structure(again) == jax.tree.structure(state)
    same((again.model, again.disparity), (state.model, state.disparity))
    same(jax.random.key_data(again.key), jax.random.key_data(state.key))
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
    grown, history = optimize(
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
        alone, _ = optimize(first_state(model), routine, goal, strategy=SIXES)
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
        optimize(first_state(model), routine, Unknown(), strategy=Growth())
    idle = Growth(recycle=False).plan(first_state(model), routine, objective(model))
    assert (idle.piece, idle.last) == (2, -1)


@pytest.mark.parametrize(("absolute", "square", "blunt"), [(0.0, 2.0, 0.01), (1.0, 1.0, 1e-4)])
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
        optimize(first_state(model), nothing, objective(model, renderer=wide))
    with pytest.raises(UserWarning, match=message):  # warnings are errors here
        minimize_least_squares(model, objective(model, renderer=wide), jnp.zeros(SHAPE))
    full = "entries of the tiles' lists exceed `SplatRaster.capacity`"
    with pytest.warns(UserWarning, match=full):
        optimize(first_state(model), nothing, objective(model, renderer=few))
    problems = eqx.filter_jit(render_model)(model, both).problems()
    assert ["`SplatRaster.radius`" in line for line in problems] == [True, False]
    with pytest.warns(UserWarning, match="SplatRaster") as said:
        compiled_render(model, both)
    assert tuple(str(warning.message) for warning in said) == problems


# Fits to a known map.
NARROW = Renderer.on_raster(1)
KNOWN = GroundTruth(TRUTH, jnp.ones(SHAPE, bool))
# Seventy places and pieces of two iterations, which are one program.
GROWING = Growth(recycle=False, extra=40, rounds=3, threshold=jnp.asarray(0.0))


def start_of(model):
    return Start(model, jnp.full(model.valid.size, jnp.inf), jnp.zeros(SHAPE))


def fitted(model=None, known=KNOWN, *, iterations=10, strategy: Strategy = GROWING, **options):
    start = start_of(start_model() if model is None else model)
    table = all_at_once(Rates.supervised(), iterations=iterations)
    options |= {"strategy": strategy, "routine": table}
    return fit_edges(known, start, SupervisedFit(), NARROW, **options)


def test_fitting_is_the_loop_with_the_defaults_that_are_written_down():
    start = start_of(start_model())
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
    told = []
    found = fitted(with_capacity(start_model(), 33), iterations=6, progress=told.append)
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
