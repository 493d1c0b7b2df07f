"""Maps that views correct, what of it is kept, and where it begins."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from mvedge_jax.depth import EdgeDepth
from mvedge_jax.lightfield import GroundTruth, LightField
from mvedge_jax.model import (
    DepthModel,
    Renderer,
    Start,
    optimize_edges,
    render_model,
    start_from_depth,
)
from mvedge_jax.model.approaches import (
    Bending,
    ByEvidence,
    ByReprojection,
    polish,
)
from mvedge_jax.model.approaches._approach import explained
from mvedge_jax.model.optimisation import Rates, all_at_once

SHAPE = (20, 22)
NARROW = Renderer.on_raster(1)
TRUE = 0.3


def plane(*, truth=None):
    """A textured plane, 5x5 views."""
    rng = np.random.default_rng(0)
    texture = ndimage.gaussian_filter(rng.uniform(size=(40, 42, 3)), (1, 1, 0)) * 2 - 0.5
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float) + 10
    views = np.zeros((5, 5, *SHAPE, 3))
    for v, u, c in np.ndindex(5, 5, 3):
        place = [y - (2 - v) * TRUE, x - (2 - u) * TRUE]
        views[v, u, ..., c] = ndimage.map_coordinates(texture[..., c], place, order=3)
    return LightField(jnp.asarray(np.clip(views, 0, 1)), truth=truth)


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
    key = jax.random.key(2)
    found = optimize_edges(plane(truth=lie), start, approach, NARROW, progress=told.append, key=key)
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
    np.testing.assert_allclose(found.disparity, polish(kept, Bending()), atol=1e-4)


@pytest.mark.slow
def test_the_edges_alone_are_a_start():
    """Points, surfaces and map of the chain without dense labels: all that a start reads."""
    field = plane()
    result = EdgeDepth.for_light_field(field, preset="edges")(field)
    start = start_from_depth(field, result)
    assert int(start.model.valid.sum()) > 50
    before = render_model(start.model, NARROW, start=start.disparity).disparity
    assert float(jnp.abs(before - start.disparity).max()) < 0.05
    routine = all_at_once(ByEvidence().rates, iterations=2)
    found = optimize_edges(field, start, ByEvidence(), NARROW, routine=routine)
    error = np.abs(np.asarray(found.disparity) - TRUE)[4:-4, 4:-4]
    assert error.max() < 0.02


def test_bad_input_is_named():
    start = level(TRUE)._replace(disparity=jnp.zeros((3, 4)))
    with pytest.raises(ValueError, match=r"`start` has the shape \(3, 4\); the views have \(20"):
        optimize_edges(plane(), start, ByEvidence(), NARROW)
    for subset in (0, -5):
        with pytest.raises(ValueError, match=f"`subset` must be at least 1.* got {subset}"):
            ByReprojection(subset=subset)
