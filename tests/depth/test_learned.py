"""Preset `learned`: the network is a part like any other, and its values come with the package."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from depth.parts import SHAPE, check_part, given
from helpers import check_modes
from numpy.testing import assert_allclose, assert_array_equal

from mvedge_jax import EdgeDepth, LightField, describe
from mvedge_jax._params import cast
from mvedge_jax._paths import value_at
from mvedge_jax.depth import DenseLabels, MeasuredLabels
from mvedge_jax.depth._learned import learned_values
from mvedge_jax.depth.solves import LabelContext, Labels, LearnedLabels
from mvedge_jax.photometry.measuring import AdaptedMeasurement


def called(part, of):
    """The part's labels on the inputs that all parts are tested with."""
    measured, views = of.evidence.measured, of.evidence.calibrated
    measuring = cast(AdaptedMeasurement(noise=jnp.asarray(0.1)), of.disparity.dtype)
    context = LabelContext(measuring, of.precision, views.lab, views.hypotheses)
    points = Labels(0.3 * (of.depth_edge > 0.1).astype(of.disparity.dtype), of.sides.initial)
    return part(points, measured, of.disparity + 0.01, context)


def untrained():
    return cast(LearnedLabels.untrained(key=jax.random.key(0)), jnp.float64)


def trained():
    """A network that says something."""
    part = untrained()
    last = jax.random.normal(jax.random.key(1), part.network.last.weight.shape)
    return eqx.tree_at(lambda p: p.network.last.weight, part, last.astype(jnp.float64))


@pytest.mark.parametrize("part", [MeasuredLabels(), trained()], ids=["measured", "learned"])
def test_dense_labels(part):
    assert isinstance(part, DenseLabels)
    found = check_part(part, called)
    assert found.weight.shape == found.value.shape == SHAPE
    assert float(found.weight.min()) > 0


def test_a_network_starts_as_the_rule_and_then_changes_weights():
    rule, start, later = (
        called(part, given()) for part in (MeasuredLabels(), untrained(), trained())
    )
    assert_allclose(start.weight, rule.weight, rtol=1e-6)
    assert_allclose(start.value, rule.value, rtol=1e-6)
    assert float(jnp.abs(later.weight / rule.weight - 1).max()) > 0.1


def test_derivatives_of_labels():
    """In the weights of the network, and in all that it sees; both modes against differences."""

    def loss(tree):
        labels = called(*tree)
        wave = jnp.cos(jnp.arange(labels.weight.size, dtype=labels.weight.dtype))
        return jnp.sum(wave.reshape(SHAPE) * labels.weight * (1 + labels.value))

    check_modes(loss, (trained(), given()), rtol=1e-5, step=1e-7, key=jax.random.key(2))


def test_the_unit_of_disparity_is_free():
    """Views that are fewer and farther apart show the same picture to the network."""
    of, more = given(), 4.0

    def stretched(values):
        return jax.tree.map(lambda leaf: more * leaf, values)

    views, measured = of.evidence.calibrated, of.evidence.measured
    assert views.hypotheses is not None
    assert measured is not None
    mean, variance = views.hypotheses.mean, views.hypotheses.variance
    hypotheses = views.hypotheses._replace(mean=more * mean, variance=more**2 * variance)
    wide = of._replace(
        disparity=more * (of.disparity + 0.01) - 0.01,
        precision=more * of.precision,
        sides=of.sides._replace(initial=stretched(of.sides.initial)),
        evidence=of.evidence._replace(
            calibrated=views._replace(hypotheses=hypotheses),
            measured=measured._replace(
                disparity=more * measured.disparity, variance=more**2 * measured.variance
            ),
        ),
    )
    part = eqx.tree_at(lambda p: p.agreement, trained(), jnp.asarray(1e6))
    assert_allclose(called(part, wide).weight, called(part, of).weight, rtol=1e-9)


@pytest.mark.parametrize("size", [(4, 4), (5, 7), (16, 9)])
def test_any_size_of_views(size):
    network = trained().network
    seen = jax.random.normal(jax.random.key(0), (network.halved.in_channels, *size), jnp.float64)
    assert network(seen).shape == size
    # What is added at the border to fill up blocks of 4 px is more of the same.
    flat = jnp.broadcast_to(seen[:, :1, :1], seen.shape)
    assert bool(jnp.isfinite(network(flat)).all())


@pytest.fixture(scope="module")
def model():
    flat = LightField(jnp.full((9, 9, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
    return EdgeDepth.for_light_field(flat, preset="learned")


def test_the_preset_has_what_was_learned(model):
    known = learned_values()
    assert sum(value.size for value in known.values()) < 30_000
    for path, value in known.items():
        assert_array_equal(value_at(model, path), value)
        assert np.isfinite(value).all()
    numbers = {row.path for row in describe(model) if not row.static}
    assert set(known) <= numbers
    thresholds = {row.path for row in describe(model) if row.threshold}
    assert not thresholds & set(known)


def test_fewer_views_have_larger_numbers_in_px(model):
    few = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
    small = EdgeDepth.for_light_field(few, preset="learned")
    for path, factor in (("refine.precision", 4), ("smoothness.depth", 4), ("smoothness.color", 1)):
        assert_allclose(value_at(small, path), factor * value_at(model, path), rtol=1e-6)
