import jax
import jax.numpy as jnp
import numpy as np
from helpers import check_gradient, count_traces

from mvedge_jax.model.approaches import Bending, polish
from mvedge_jax.model.approaches._polish import bending


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
