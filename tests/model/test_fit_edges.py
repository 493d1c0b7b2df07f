import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mvedge_jax.lightfield import GroundTruth
from mvedge_jax.model import (
    DepthModel,
    Renderer,
    Start,
    SupervisedFit,
    fit_edges,
    render_model,
)
from mvedge_jax.model._model import with_capacity
from mvedge_jax.model.objectives import Supervised, unlimited
from mvedge_jax.model.optimisation import (
    FixedPoints,
    Growth,
    Rates,
    State,
    advance,
    all_at_once,
    begin,
)

SHAPE = (14, 18)
NARROW = Renderer.on_raster(1)
KNOWN = GroundTruth(jnp.zeros(SHAPE).at[4:10, 6:13].set(1.0), jnp.ones(SHAPE, bool))


def noisy_start(n=30, seed=0):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, [SHAPE[1] - 1, SHAPE[0] - 1], (n, 2))
    column, row = np.round(xy).astype(int).T
    label = jnp.asarray(np.asarray(KNOWN.disparity)[row, column] + 0.1 * rng.normal(size=n))
    model = DepthModel(label, jnp.asarray(xy), 0 * label, jnp.zeros(SHAPE), jnp.ones(n, bool))
    return Start(model, jnp.full(n, jnp.inf), jnp.zeros(SHAPE))


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
    rendered = render_model(state.best, NARROW).disparity
    np.testing.assert_allclose(found.disparity, rendered, atol=1e-4)
    assert float(found.history.loss[-1]) < 0.5 * float(found.history.loss[0])


def test_free_places_leave_points_are_added_and_a_state_goes_on(tmp_path):
    start = noisy_start()
    roomy = start._replace(model=with_capacity(start.model, 33), error=jnp.pad(start.error, (0, 3)))
    table, told = all_at_once(Rates.supervised(), iterations=8), []
    options = {"strategy": Growth(recycle=False, extra=5, rounds=2), "routine": table}
    found = fit_edges(KNOWN, roomy, SupervisedFit(), NARROW, progress=told.append, **options)
    assert found.model.valid.tolist() == 35 * [True]
    assert [int(now.grown.added) for now in told if now.grown is not None] == [5]
    told[1].state.save(tmp_path / "half.eqx")
    half = State.load(tmp_path / "half.eqx")
    again = fit_edges(KNOWN, roomy, SupervisedFit(), NARROW, state=half, **options)
    assert again.history.loss.shape == (8 - int(half.iteration),)
    same(found.model, again.model)
    with pytest.raises(ValueError, match="`state` has 35 points .*; the start has 30 points"):
        fit_edges(KNOWN, start, SupervisedFit(), NARROW, state=half, strategy=FixedPoints())


def test_a_map_of_another_shape_is_refused():
    small = GroundTruth(jnp.zeros((3, 4)), jnp.ones((3, 4), bool))
    with pytest.raises(ValueError, match=r"`truth` has the shape \(3, 4\); the map of `start`"):
        fit_edges(small, noisy_start(), SupervisedFit(), NARROW)


def test_unknown_pixels_have_no_say():
    start, table = noisy_start(), all_at_once(Rates.supervised(), iterations=2)
    valid = KNOWN.valid.at[0, 0].set(False)
    maps = [
        fit_edges(
            GroundTruth(KNOWN.disparity.at[0, 0].set(value), valid),
            start, SupervisedFit(), NARROW, routine=table, strategy=Growth(rounds=1),
        ).disparity
        for value in (0.0, 9.0)
    ]  # fmt: skip
    np.testing.assert_array_equal(maps[0], maps[1])


@pytest.mark.parametrize("recycle", [False, True])
def test_a_state_from_between_two_rounds_goes_on_the_same(recycle):
    table, told = all_at_once(Rates.supervised(), iterations=10), []
    growth = Growth(recycle=recycle, extra=40, rounds=3, threshold=jnp.asarray(0.0))
    options = {"strategy": growth, "routine": table}
    whole = fit_edges(
        KNOWN, noisy_start(), SupervisedFit(), NARROW, progress=told.append, **options
    )
    assert whole.model.valid.sum() == 70
    # The first of three rounds is over.
    resumed = fit_edges(
        KNOWN, noisy_start(), SupervisedFit(), NARROW, state=told[0].state, **options
    )
    same(whole.model, resumed.model)


@pytest.mark.parametrize("iterations", [7, 12])
def test_free_places_are_filled_in_time(iterations):
    """Rounds are evenly spaced, so that there may be fewer than `rounds`."""
    found = fit_edges(
        KNOWN, noisy_start(), SupervisedFit(), NARROW,
        strategy=Growth(recycle=False, extra=90, threshold=jnp.asarray(0.0)),
        routine=all_at_once(Rates.supervised(), iterations=iterations),
    )  # fmt: skip
    assert bool(found.model.valid.all())


def test_rounds_without_a_new_point_forget_nothing():
    start = noisy_start()
    label = jnp.full(start.model.disparity.shape, 0.5)
    exact = start._replace(model=eqx.tree_at(lambda m: m.disparity, start.model, label))
    known = GroundTruth(jnp.full(SHAPE, 0.5), KNOWN.valid)
    found = fit_edges(
        known, exact, SupervisedFit(), NARROW, strategy=Growth(),
        routine=all_at_once(Rates.supervised(), iterations=12),
    )  # fmt: skip
    np.testing.assert_allclose(found.disparity, 0.5, atol=1e-6)
