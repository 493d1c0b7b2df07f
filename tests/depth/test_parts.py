"""Every implementation of a part keeps what its protocol says: one template for all of them.

Values are the same with and without `jit` and under `vmap`, gradients finite, empty slots without
influence, and the precision that of the data.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from depth.parts import SHAPE, check_part, given
from jaxtyping import Array

from mvedge_jax._params import cast, number
from mvedge_jax.depth import (
    NearestLabels,
    PointLabels,
    PointWeight,
    SharedLabels,
    SplattedLabels,
    StepWeight,
)
from mvedge_jax.diffusion import AutoSolver
from mvedge_jax.edges.sides import (
    BidirectionalSides,
    DirectionalDiffusion,
    MapSides,
    NoSides,
    ReprojectionSides,
    SideChoice,
    ThesisSides,
)
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


def test_a_smoothness_is_whole_where_nothing_changes():
    flat = jnp.zeros((3, 6, 7)), jnp.zeros((6, 7)), jnp.zeros((6, 7))
    for part in (ColorAndDepth(), ThesisSmoothness(), ImageGradient()):
        for t in part(*flat):
            np.testing.assert_allclose(t, 1, atol=1e-5)
    # That of the thesis is one half at its confidence.
    thesis = ThesisSmoothness()
    tx, _ = thesis(*flat[:2], flat[2].at[:, 3].set(thesis.depth_edge))
    np.testing.assert_allclose(tx[:, 0], 1)
    np.testing.assert_allclose(tx[:, 2:4], 0.5)


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
    return DirectionalDiffusion(solver=AutoSolver(tolerance=jnp.asarray(1e-10)))


@each(
    BidirectionalSides(diffusion=_precise()),
    MapSides(),
    ThesisSides(diffusion=_precise()),
    ReprojectionSides(radius=2, diffusion=_precise()),
    NoSides(),
)
def test_sides(part):
    assert isinstance(part, SideChoice)
    tolerance = {} if isinstance(part, NoSides) else {"rtol": 1e-5, "atol": 1e-6}
    found = check_part(part, lambda p, of: p(of.points, of.evidence), **tolerance)
    valid = np.asarray(given().points.valid)
    assert found.edge.shape == found.initial.shape == SHAPE
    assert not np.asarray(found.surface.offset)[~valid].any()
    np.testing.assert_array_equal(np.asarray(found.surface.forward)[~valid], 0.5)
    length = np.linalg.norm(np.asarray(found.surface.offset)[valid], axis=1)
    np.testing.assert_allclose(length, 0 if isinstance(part, NoSides) else 1, atol=1e-9)


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
    np.testing.assert_allclose(np.asarray(found)[[0, 1, 3]], expected)
    assert float(found[2]) == 0


def test_confidences_are_those_of_the_profiles_as_they_are_where_the_thesis_says_so():
    case = given()
    points = eqx.tree_at(lambda p: p.disparity, case.points, 0.1 * case.points.disparity)
    half = eqx.tree_at(lambda p: p.disparity, points, 0.5 * points.disparity)

    def confidence(stretched, points):
        part = ThesisSides(diffusion=_precise(), stretched=stretched)
        return np.asarray(part(points, case.evidence).confidence)[np.asarray(points.valid)]

    printed = confidence(False, points)
    assert printed.max() > 0
    np.testing.assert_allclose(confidence(False, half), 0.5 * printed, atol=1e-7)
    # Stretched profiles do not know the height of a step.
    np.testing.assert_allclose(confidence(True, half), confidence(True, points), atol=1e-3)
