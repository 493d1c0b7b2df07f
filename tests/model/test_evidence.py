import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import count_traces

from mvedge_jax.lightfield import LightField
from mvedge_jax.losses import Views, all_views, gather_views
from mvedge_jax.model import Renderer, StartFit
from mvedge_jax.model._start import start_from_points
from mvedge_jax.model.approaches import ByEvidence, ViewAgreement
from mvedge_jax.model.approaches._approach import explained
from mvedge_jax.model.approaches._evidence import agreed_correction
from mvedge_jax.model.optimisation import Rates, advance, all_at_once, begin
from mvedge_jax.splatting import SplatLabels, SplatRaster, SplatWidths

SHAPE = (20, 22)


def scene(disparity=0.3, *, noise=0.0, reach=2, dtype: type = np.float32):
    """Views of a fronto-parallel texture of sinusoids."""
    rng = np.random.default_rng(0)
    waves = rng.uniform(-1.2, 1.2, (12, 2))
    phases = rng.uniform(0, 2 * np.pi, (3, 12))
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)

    def image(step):
        # The point (x, y) of the centre is at (x + s d) in the view, so the view shows x - s d.
        at_x, at_y = x - step[0] * disparity, y - step[1] * disparity
        arguments = waves[:, 0, None, None] * at_x + waves[:, 1, None, None] * at_y
        planes = 0.5 + 0.03 * np.sin(arguments[None] + phases[:, :, None, None]).sum(1)
        return planes + noise * rng.normal(size=planes.shape)

    places = np.arange(-reach, reach + 1)
    steps = [(float(i), float(j)) for i in places for j in places if (i, j) != (0, 0)]
    others = np.stack([image(s) for s in steps])
    return Views(
        jnp.asarray(image((0.0, 0.0)), dtype),
        jnp.asarray(others, dtype),
        jnp.asarray(steps, dtype),
        jnp.ones(len(steps), bool),
    )


def grid(views):
    """A light field of the same views."""
    reach = int(views.steps.max())
    images = np.zeros((2 * reach + 1, 2 * reach + 1, *SHAPE, 3), views.centre.dtype)
    images[reach, reach] = np.moveaxis(views.centre, 0, -1)
    for image, (x, y) in zip(views.others, np.asarray(views.steps, int), strict=True):
        images[reach - y, reach - x] = np.moveaxis(image, 0, -1)
    return LightField(jnp.asarray(images))


def flat(value):
    return jnp.full(SHAPE, value, jnp.float32)


def inner(image):
    return np.asarray(image)[5:-5, 5:-5]


def agreed(views, disparity, params=None):
    params = ViewAgreement() if params is None else params
    return agreed_correction(views, disparity, params, radius=2)


def test_halves_of_the_views_confirm_an_error():
    found = agreed(scene(), flat(0.33))
    np.testing.assert_allclose(inner(found.change), -0.03, atol=0.004)
    assert inner(found.share).min() > 0.9


def test_a_map_that_is_right_stays_and_so_does_one_that_no_view_speaks_of():
    np.testing.assert_allclose(inner(agreed(scene(), flat(0.3)).change), 0, atol=0.004)
    blind = eqx.tree_at(lambda v: v.available, scene(), jnp.zeros(24, bool))
    np.testing.assert_allclose(agreed(blind, flat(0.33)).change, 0, atol=1e-6)


def test_halves_do_not_confirm_noise():
    change = agreed(scene(noise=0.02), flat(0.3)).change
    params = ViewAgreement(region=jnp.asarray(1e-3))
    alone = agreed(scene(noise=0.02), flat(0.3), params).change
    assert np.square(inner(change)).mean() < np.square(inner(alone)).mean()


def test_one_trace_serves_all_parameters_and_x64_changes_little():
    single, double = scene(), scene(dtype=np.float64)
    traced, traces = count_traces(lambda v, d, p: agreed(v, d, p).change)
    wrong = jnp.full(SHAPE, 0.31, jnp.float32)
    first = traced(single, wrong, ViewAgreement())
    traced(single, wrong, ViewAgreement(region=jnp.asarray(2.0)))
    assert traces() == 1
    assert first.dtype == jnp.float32
    exact = agreed(double, wrong.astype(jnp.float64)).change
    np.testing.assert_allclose(first, exact, atol=2e-4)


def test_all_views_leaves_out_the_centre_and_what_is_missing():
    available = jnp.ones((3, 3), bool).at[0, 0].set(False)
    light_field = LightField(jnp.zeros((3, 3, 4, 5, 3)), available=available)
    chosen = all_views(light_field)
    assert len(chosen) == 7
    assert (1, 1) not in chosen
    assert gather_views(light_field, choice=chosen).steps.shape == (7, 2)


@pytest.mark.slow
def test_refinement_corrects_a_map_as_far_as_the_views_say():
    views = scene()
    first = jnp.full(SHAPE, 0.32, jnp.float32)
    rng = np.random.default_rng(1)
    xy = jnp.asarray(rng.uniform(0, [SHAPE[1] - 1, SHAPE[0] - 1], (60, 2)), jnp.float32)
    start = start_from_points(
        xy, jnp.full(60, 0.32, jnp.float32), jnp.full(60, 0.01, jnp.float32), jnp.ones(60, bool),
        jnp.moveaxis(views.centre, 0, -1), first, StartFit(),
    )  # fmt: skip
    wide = Renderer(SplatLabels(SplatWidths(), SplatRaster(scale=1, lanes=16)))
    approach = ByEvidence()
    ready = approach.prepare(grid(views), start, wide)
    state = begin(ready.start.model, ready.start.disparity, key=jax.random.key(0))
    unchanged, _ = approach.finish(
        grid(views), ready, eqx.tree_at(lambda s: s.best, state, ready.start.model)
    )
    np.testing.assert_allclose(unchanged, ready.base, atol=1e-3)
    rates = Rates(rate=jnp.asarray([0.02, 0.002, 0.02, 0.01]))
    state, history = advance(state, all_at_once(rates, iterations=30), ready.objective)
    assert float(history.loss[-1]) < 0.3 * float(history.loss[0])
    refined, verdict = approach.finish(grid(views), ready, state)
    assert np.abs(inner(refined) - 0.3).max() < 0.25 * np.abs(inner(first) - 0.3).max()
    assert bool(verdict.kept)
    # The true map has an error, too: views are interpolated linearly, and end.
    least = explained(grid(views), flat(0.3), flat(0.3), approach.features)[0]
    assert float(verdict.error[1] - least) < 0.1 * float(verdict.error[0] - least)
    assert verdict.confirmed is not None
    assert ready.correction is not None
    assert float(verdict.confirmed) == pytest.approx(float(ready.correction.share.mean()))
    # No pixel leaves what the views support.
    change, twice = np.asarray(refined - ready.base), 2 * ready.correction.change
    assert np.all(np.abs(change) <= np.abs(twice) + 2e-3)


def test_nothing_is_measured_beside_depth_steps():
    """Windows reach across them, and so do neighbours that share their measurements."""
    step = jnp.where(jnp.arange(SHAPE[1]) > SHAPE[1] // 2, 0.8, 0.3)
    found = agreed(scene(), jnp.broadcast_to(step, SHAPE).astype(jnp.float32))
    beside = np.abs(np.arange(SHAPE[1]) - (SHAPE[1] // 2 + 0.5)) < 5
    np.testing.assert_array_equal(np.asarray(found.weight)[:, beside], 0)
    assert np.all(np.asarray(found.weight)[:, 2:5] > 0)
