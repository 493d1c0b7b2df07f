import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import count_traces

from mvedge_jax.lightfield import LightField
from mvedge_jax.losses import Views, all_views, gather_views
from mvedge_jax.reconstruct import (
    EvidenceParams,
    ModelParams,
    ModelSizes,
    Rates,
    RefineParams,
    RelocateParams,
    StartParams,
    advance,
    agreed_correction,
    all_at_once,
    begin,
    finish_refinement,
    polish,
    prepare_refinement,
    relocate_steps,
    start_from_points,
    view_evidence,
)
from mvedge_jax.splatting import SplatSizes

SHAPE = (20, 22)


def scene(disparity=0.3, *, drift=0.0, noise=0.0, reach=2, dtype: type = np.float32):
    """Views of a fronto-parallel texture of sinusoids, whose colours may drift over the views."""
    rng = np.random.default_rng(0)
    waves = rng.uniform(-1.2, 1.2, (12, 2))
    phases = rng.uniform(0, 2 * np.pi, (3, 12))
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)

    def image(step):
        # The point (x, y) of the centre is at (x + s d) in the view, so the view shows x - s d.
        at_x, at_y = x - step[0] * disparity, y - step[1] * disparity
        arguments = waves[:, 0, None, None] * at_x + waves[:, 1, None, None] * at_y
        planes = 0.5 + 0.03 * np.sin(arguments[None] + phases[:, :, None, None]).sum(1)
        # A slope of the brightness beside its drift: what shading of a curved, glossy surface does.
        shade = 0.02 * x + drift * (step[0] + 0.5 * step[1])
        return planes + shade + noise * rng.normal(size=planes.shape)

    places = np.arange(-reach, reach + 1)
    steps = [(float(i), float(j)) for i in places for j in places if (i, j) != (0, 0)]
    others = np.stack([image(s) for s in steps])
    return Views(
        jnp.asarray(image((0.0, 0.0)), dtype),
        jnp.asarray(others, dtype),
        jnp.asarray(steps, dtype),
        jnp.ones(len(steps), bool),
    )


def flat(value):
    return jnp.full(SHAPE, value, jnp.float32)


def inner(image):
    return np.asarray(image)[5:-5, 5:-5]


def test_the_error_of_a_map_is_found_and_a_right_map_is_left():
    views = scene()
    for error in (0.0, 0.02, -0.03):
        found = view_evidence(views, flat(0.3 + error), EvidenceParams())
        np.testing.assert_allclose(inner(found.change), -error, atol=0.002)
        assert inner(found.variance).max() < 0.003**2


def test_a_drift_of_colours_is_not_taken_for_parallax():
    """Oracle: the true disparity. Without the drift in the model it is missed by far."""
    views, right = scene(drift=0.01), flat(0.3)
    free = view_evidence(views, right, EvidenceParams())
    fixed = view_evidence(views, right, EvidenceParams(drift=jnp.asarray(1e8)))
    assert np.abs(inner(free.change)).max() < 0.003
    assert np.median(np.abs(inner(fixed.change))) > 0.02


def test_where_nothing_is_seen_nothing_is_said():
    views, right = scene(), flat(0.3)
    params = EvidenceParams()
    blind = eqx.tree_at(lambda v: v.available, views, jnp.zeros(24, bool))
    dark = Views(
        jnp.zeros_like(views.centre), jnp.zeros_like(views.others), views.steps, views.available
    )
    for nothing in (blind, dark):
        found = view_evidence(nothing, right, params)
        np.testing.assert_allclose(found.change, 0, atol=1e-6)
        np.testing.assert_allclose(found.variance, params.largest**2, rtol=1e-3)
    broken = eqx.tree_at(
        lambda v: (v.others, v.available),
        views,
        (views.others.at[3].set(9.0), views.available.at[3].set(False)),
    )
    clean = eqx.tree_at(lambda v: v.available, views, views.available.at[3].set(False))
    for a, b in zip(
        view_evidence(broken, right, params), view_evidence(clean, right, params), strict=True
    ):
        np.testing.assert_array_equal(a, b)


@pytest.mark.slow
def test_halves_of_the_views_confirm_an_error_but_not_noise():
    params = EvidenceParams()
    wrong = flat(0.33)
    found = agreed_correction(scene(), wrong, params)
    np.testing.assert_allclose(inner(found.change), -0.03, atol=0.004)
    assert inner(found.share).min() > 0.9
    blind = eqx.tree_at(lambda v: v.available, scene(), jnp.zeros(24, bool))
    np.testing.assert_allclose(agreed_correction(blind, wrong, params).change, 0, atol=1e-6)
    noisy = scene(noise=0.02)
    right = flat(0.3)
    proposed = view_evidence(noisy, right, params).change
    agreed = agreed_correction(noisy, right, params).change
    assert np.square(inner(agreed)).mean() < 0.5 * np.square(inner(proposed)).mean()


@pytest.mark.slow
def test_one_trace_serves_all_parameters_and_x64_changes_little():
    single, double = scene(), scene(dtype=np.float64)
    traced, traces = count_traces(lambda v, d, p: agreed_correction(v, d, p).change)
    wrong = jnp.full(SHAPE, 0.31, jnp.float32)
    first = traced(single, wrong, EvidenceParams())
    traced(single, wrong, EvidenceParams(region=jnp.asarray(2.0)))
    assert traces() == 1
    assert first.dtype == jnp.float32
    exact = agreed_correction(double, wrong.astype(jnp.float64), EvidenceParams()).change
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
        jnp.moveaxis(views.centre, 0, -1), first, StartParams(),
    )  # fmt: skip
    sizes, params = ModelSizes(splat=SplatSizes(scale=1, lanes=16)), RefineParams()
    refinement = prepare_refinement(start, first, views, params, ModelParams(), sizes, iterations=4)
    unchanged = finish_refinement(refinement, refinement.start.model, params)
    np.testing.assert_allclose(unchanged, refinement.base, atol=1e-3)
    rates = Rates(rate=jnp.asarray([0.02, 0.002, 0.02, 0.01]))
    state = begin(refinement.start.model, refinement.rendered, key=jax.random.key(0))
    state, history = advance(state, all_at_once(rates, iterations=30), refinement.objective)
    assert float(history.loss[-1]) < 0.3 * float(history.loss[0])
    refined = finish_refinement(refinement, state.best, params)
    assert np.abs(inner(refined) - 0.3).max() < 0.25 * np.abs(inner(first) - 0.3).max()
    # No pixel leaves what the views support.
    change, twice = np.asarray(refined - refinement.base), 2 * refinement.correction.change
    assert np.all(np.abs(change) <= np.abs(twice) + 2e-3)


@pytest.mark.slow
def test_refinement_relocates_steps_in_doubt_first():
    views = scene()
    step = jnp.arange(SHAPE[1]) > SHAPE[1] // 2
    first = jnp.broadcast_to(jnp.where(step, 0.8, 0.3), SHAPE).astype(jnp.float32)
    xy = jnp.asarray(np.random.default_rng(1).uniform(0, 19, (60, 2)), jnp.float32)
    start = start_from_points(
        xy, jnp.full(60, 0.3, jnp.float32), jnp.full(60, 0.01, jnp.float32), jnp.ones(60, bool),
        jnp.moveaxis(views.centre, 0, -1), first, StartParams(),
    )  # fmt: skip
    sizes = ModelSizes(splat=SplatSizes(scale=1, lanes=16))
    params = RefineParams(relocate=RelocateParams())
    found = prepare_refinement(start, first, views, params, ModelParams(), sizes, iterations=2)
    relocated = relocate_steps(first, views.centre, RelocateParams())
    assert jnp.abs(relocated - first).max() > 0.1
    np.testing.assert_allclose(found.base, polish(relocated, params.polish), rtol=0, atol=1e-5)
