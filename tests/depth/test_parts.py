"""Every implementation of a part keeps what its protocol says: one template for all of them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optax
import pytest
from depth.parts import SHAPE, check_part, given
from jaxtyping import Array
from numpy.testing import assert_allclose, assert_array_equal

from mvedge_jax import EdgeDepth, lean_jit, multiview_edges
from mvedge_jax._params import cast, number
from mvedge_jax.datasets import synthetic
from mvedge_jax.depth import (
    NearestLabels,
    PointLabels,
    PointWeight,
    SharedLabels,
    SplattedLabels,
    StepWeight,
)
from mvedge_jax.diffusion import AutoSolver
from mvedge_jax.edges import sides
from mvedge_jax.smoothness import ColorAndDepth, ImageGradient, Smoothness, ThesisSmoothness


class _OfTheUser(eqx.Module):
    """A network of the user's: one convolution of colors and map."""

    convolution: eqx.nn.Conv2d
    gain: Array = number(0.5)

    def __init__(self, key):
        self.convolution = eqx.nn.Conv2d(4, 2, 3, padding=1, key=key, dtype=jnp.float64)
        self.gain = jnp.asarray(0.5)

    def __call__(self, guide, disparity, depth_edge):
        del depth_edge
        seen = jnp.concatenate([guide / 50, disparity[None]])
        layer = cast(self, disparity.dtype)
        right, down = jax.nn.sigmoid(layer.gain * layer.convolution(seen))
        return right[:, :-1], down[:-1]


def each(*parts):
    """A case for every part."""
    return pytest.mark.parametrize("part", parts, ids=lambda part: type(part).__name__)


@each(ColorAndDepth(), ThesisSmoothness(), ImageGradient(), _OfTheUser(jax.random.key(0)))
def test_smoothness(part):
    assert isinstance(part, Smoothness)
    tx, ty = check_part(part, lambda p, of: p(of.guide, of.disparity, of.depth_edge))
    height, width = SHAPE
    assert (tx.shape, ty.shape) == ((height, width - 1), (height - 1, width))
    for t in (tx, ty):
        assert float(t.min()) > 0
        assert float(t.max()) <= 1


@each(SharedLabels(), NearestLabels(), SplattedLabels())
def test_labels(part):
    assert isinstance(part, PointLabels)
    found = check_part(part, lambda p, of: p(of.points, of.sides, of.evidence, of.precision))
    assert found.weight.shape == found.value.shape == SHAPE
    assert float(found.weight.min()) >= 0
    # Some pixels have a label and others have none; labels are those of the points.
    labeled = np.asarray(found.weight) > 1e-6
    assert labeled.any()
    assert not labeled.all()
    low, high = (f(np.asarray(given().points.disparity)) for f in (np.min, np.max))
    values = np.asarray(found.value)[labeled]
    assert values.min() >= low - 1e-9
    assert values.max() <= high + 1e-9


def _precise():
    """Results of a solver agree to its tolerance."""
    return sides.DirectionalDiffusion(solver=AutoSolver(tolerance=jnp.asarray(1e-10)))


@each(
    sides.BidirectionalSides(diffusion=_precise()),
    sides.MapSides(),
    sides.ThesisSides(diffusion=_precise()),
    sides.ReprojectionSides(radius=2, diffusion=_precise()),
    sides.NoSides(),
)
def test_sides(part):
    assert isinstance(part, sides.SideChoice)
    tolerance = {} if isinstance(part, sides.NoSides) else {"rtol": 1e-5, "atol": 1e-6}
    found = check_part(part, lambda p, of: p(of.points, of.evidence), **tolerance)
    valid = np.asarray(given().points.valid)
    assert found.edge.shape == found.initial.shape == SHAPE
    assert not np.asarray(found.surface.offset)[~valid].any()
    assert_array_equal(np.asarray(found.surface.forward)[~valid], 0.5)
    length = np.linalg.norm(np.asarray(found.surface.offset)[valid], axis=1)
    assert_allclose(length, 0 if isinstance(part, sides.NoSides) else 1, atol=1e-9)


@each(StepWeight(), PointWeight())
def test_weights_grow_with_the_confidence_up_to_the_limit(part):
    points = given().points
    points = eqx.tree_at(lambda p: p.error, points, jnp.full_like(points.error, 0.005))
    confidence = jnp.zeros_like(points.error).at[1].set(1.0).at[3].set(50.0)
    found = part(confidence, points, jnp.asarray(0.005))
    expected = np.exp([-4.0, -1.0, 0.0])
    if isinstance(part, PointWeight):
        # The points' standard error is the one at which a label counts half.
        expected = 0.25 * (1 + expected)
    assert_allclose(np.asarray(found)[[0, 1, 3]], expected)
    assert float(found[2]) == 0


# Small programs; `test_edge_depth.py` has the preset whole.
SMALL = {"refine.sharpen.levels": 6, "refine.sharpen.radius": 2, "refine.slopes": None}


@pytest.fixture(scope="module")
def scene():
    return synthetic.render(
        synthetic.scene("edges"), shape=(3, 3, 24, 28), samples=2, key=jax.random.key(0)
    )


@pytest.fixture(scope="module")
def model(scene):
    return EdgeDepth.for_light_field(scene.without_truth(), preset="edges", choices=SMALL)


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


def test_another_solver_is_taken(scene, model):
    other = model.replace(solver=lx.CG(rtol=1e-5, atol=1e-5))
    found = jax.eval_shape(other, scene.without_truth())
    assert found.disparity.shape == (24, 28)


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
