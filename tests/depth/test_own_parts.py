"""Parts of a user's own, in about thirty lines each: no file of the package is touched for them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optax
import pytest

from mvedge_jax import EdgeDepth, lean_jit, multiview_edges
from mvedge_jax.datasets import synthetic
from mvedge_jax.smoothness import ColorAndDepth

# Small programs; `test_presets.py` has the preset whole.
SMALL = {"refine.sharpen.levels": 6, "refine.sharpen.radius": 2, "refine.slopes": None}


@pytest.fixture(scope="module")
def scene():
    return synthetic.render(
        synthetic.scene("edges"), shape=(3, 3, 24, 28), samples=2, key=jax.random.key(0)
    )


@pytest.fixture(scope="module")
def model(scene):
    return EdgeDepth.for_light_field(scene.without_truth(), preset="edges", choices=SMALL)


class Network(eqx.Module):
    """Scales the smoothness of the rule by two convolutions of what it sees; at first by 1/2."""

    first: eqx.nn.Conv2d
    last: eqx.nn.Conv2d

    def __init__(self, key):
        keys = jax.random.split(key)
        self.first = eqx.nn.Conv2d(5, 6, 3, padding=1, key=keys[0], dtype=jnp.float32)
        last = eqx.nn.Conv2d(6, 2, 3, padding=1, key=keys[1], dtype=jnp.float32)
        self.last = jax.tree.map(jnp.zeros_like, last)

    def __call__(self, guide, disparity, depth_edge):
        seen = jnp.concatenate([guide / 50, disparity[None], depth_edge[None]])
        right, down = jax.nn.sigmoid(self.last(jax.nn.tanh(self.first(seen))))
        tx, ty = ColorAndDepth()(guide, disparity, depth_edge)
        return tx * right[:, :-1], ty * down[:-1]


def test_a_network_for_the_smoothness_learns(scene, model):
    blind, truth, adam = scene.without_truth(), scene.truth.disparity, optax.adam(0.03)

    def loss(network, light_field):
        found = model.replace(smoothness=network)(light_field).disparity
        return jnp.mean(jnp.log1p(((found - truth) / 0.05) ** 2))

    @lean_jit
    def step(network, state, light_field):
        value, slope = eqx.filter_value_and_grad(loss)(network, light_field)
        # Optax divides by an integer count.
        with jax.numpy_dtype_promotion("standard"):
            updates, state = adam.update(slope, state)
        return eqx.apply_updates(network, updates), state, value

    network, values = Network(jax.random.key(0)), []
    state = adam.init(eqx.filter(network, eqx.is_inexact_array))
    for _ in range(20):
        network, state, value = step(network, state, blind)
        values.append(float(value))
    assert np.isfinite(values).all()
    assert values[-1] < 0.9 * values[0], values


def test_another_bank_of_filters_finds_other_points(scene, model):
    """Differences of single views instead of Prewitt's steps: half of the bank's views are off."""
    blind = scene.without_truth()
    banks = model.edges.prewitt(blind.views.shape, blind.views.dtype)

    def outer_views_only(bank):
        middle = bank.taps.shape[1] // 2
        return eqx.tree_at(lambda b: b.taps, bank, bank.taps.at[:, middle].set(0))

    other = model.replace({"edges.banks": tuple(map(outer_views_only, banks))})
    before = multiview_edges.traces
    usual = multiview_edges(blind, model.replace({"edges.banks": banks})).points
    found = multiview_edges(blind, other).points
    assert multiview_edges.traces == before + 1
    assert int(found.valid.sum()) > 20
    both = np.asarray(found.valid & usual.valid)
    assert np.abs(np.asarray(found.xy) - np.asarray(usual.xy))[both].max() > 0.01


CONJUGATE = lx.CG(rtol=1e-5, atol=1e-5)


def test_another_solver_is_taken(scene, model):
    found = jax.eval_shape(model.replace(solver=CONJUGATE), scene.without_truth())
    assert found.disparity.shape == (24, 28)


@pytest.mark.slow
def test_another_solver_gives_the_same_map(scene, model):
    blind = scene.without_truth()
    usual, found = model(blind), model.replace(solver=CONJUGATE)(blind)
    assert bool(found.stats.converged)
    difference = np.abs(np.asarray(found.disparity) - np.asarray(usual.disparity))
    assert np.median(difference) < 1e-3
    assert np.quantile(difference, 0.95) < 0.02
