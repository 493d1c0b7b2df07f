"""What corrects a first map: views that agree, bending that is polished."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from helpers import check_gradient, count_traces

from mvedge_jax.losses import Views
from mvedge_jax.model.approaches import Bending, ViewAgreement, polish
from mvedge_jax.model.approaches._evidence import agreed_correction
from mvedge_jax.model.approaches._polish import bending

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
    alone = ViewAgreement(region=jnp.asarray(1e-3))
    change, own = (agreed(scene(noise=0.02), flat(0.3), p).change for p in (None, alone))
    assert np.square(inner(change)).mean() < np.square(inner(own)).mean()


def test_one_trace_serves_all_parameters_and_x64_changes_little():
    single, double = scene(), scene(dtype=np.float64)
    traced, traces = count_traces(lambda v, d, p: agreed(v, d, p).change)
    first = traced(single, flat(0.31), ViewAgreement())
    traced(single, flat(0.31), ViewAgreement(region=jnp.asarray(2.0)))
    assert traces() == 1
    assert first.dtype == jnp.float32
    exact = agreed(double, flat(0.31).astype(jnp.float64)).change
    np.testing.assert_allclose(first, exact, atol=2e-4)


def test_nothing_is_measured_beside_depth_steps():
    """Windows reach across them, and so do neighbours that share their measurements."""
    step = jnp.where(jnp.arange(SHAPE[1]) > SHAPE[1] // 2, 0.8, 0.3)
    found = agreed(scene(), jnp.broadcast_to(step, SHAPE).astype(jnp.float32))
    beside = np.abs(np.arange(SHAPE[1]) - (SHAPE[1] // 2 + 0.5)) < 5
    np.testing.assert_array_equal(np.asarray(found.weight)[:, beside], 0)
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


def test_noise_goes_and_the_step_stays():
    truth = surfaces()
    noisy = truth + 0.004 * jax.random.normal(jax.random.key(0), truth.shape)
    found = polish(noisy, Bending())
    before, after = (float(jnp.sqrt(jnp.mean((m - truth) ** 2))) for m in (noisy, found))
    assert after < 0.5 * before
    np.testing.assert_array_equal(found[:, 14:16], noisy[:, 14:16])
    np.testing.assert_allclose(polish(truth, Bending()), truth, atol=1e-3)


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
    np.testing.assert_allclose(of_map, 40 * jnp.cos(40 * polish(rough, Bending())), rtol=1e-9)
    assert all(float(leaf) == 0 for leaf in jax.tree.leaves(of_params))
    _, forward = jax.jvp(polish, (rough, Bending()), (rough, Bending()))
    np.testing.assert_array_equal(forward, rough)
