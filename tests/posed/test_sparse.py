"""The thesis' multi-view stereo: points that are projected, diffused and optimized."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from posed.walls import MATRIX, POSES, places, wall

from mvedge_jax.model import DepthModel
from mvedge_jax.posed import Photographs, reference_of
from mvedge_jax.posed.objective import posed_loss
from mvedge_jax.posed.scores import depth_errors
from mvedge_jax.posed.sparse import SparseStereoDepth, _with_edges, seen_points, sparse_stereo

IMAGES, DEPTHS = wall(POSES)
RANGE = (1.2, 3.5)
INDEX = 1
# Points of the wall, seen from photograph 1, and two that it cannot see.
PIXELS = np.random.default_rng(0).permutation(DEPTHS[INDEX].size)[:40]
POINTS = np.concatenate(
    [places(POSES[INDEX], DEPTHS[INDEX]).reshape(-1, 3)[PIXELS], [[0, 0, -3.0], [9.0, 0, 2.0]]]
)


def photographs(points=POINTS, poses=POSES):
    return Photographs(jnp.asarray(IMAGES), poses, MATRIX, points=points)


WANTED = reference_of(photographs(), INDEX, depth_range=RANGE)


def test_points_are_where_the_photograph_shows_them():
    seen = seen_points(photographs(), WANTED)
    rows, columns = np.divmod(PIXELS, IMAGES.shape[2])
    assert_allclose(seen.xy[:-2], np.stack([columns, rows], 1), atol=1e-9)
    scale = float(WANTED.scale(photographs()))
    assert_allclose(seen.disparity[:-2], scale / DEPTHS[INDEX].ravel()[PIXELS])
    assert np.asarray(seen.valid).tolist() == [True] * 40 + [False] * 2
    # Only points that the photograph saw.
    observed = np.ones((4, 42), bool)
    observed[INDEX, :10] = False
    view = Photographs(jnp.asarray(IMAGES), POSES, MATRIX, points=POINTS, observed=observed)
    assert int(seen_points(view, WANTED).valid.sum()) == 30


def test_the_truth_explains_the_photographs_best():
    truth = WANTED.scale(photographs()) / jnp.asarray(DEPTHS[INDEX])
    weights, views = SparseStereoDepth().weights, WANTED.views(photographs())
    loss = jax.jit(lambda d: posed_loss(truth + d, views, weights))
    losses = [float(loss(d)) for d in (-0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.2)]
    assert losses == sorted(losses[:4], reverse=True) + sorted(losses[4:])


@pytest.mark.slow
def test_optimizing_makes_the_diffused_points_better():
    noise, center = np.random.default_rng(1).normal(scale=0.04, size=(42, 1)), POSES[INDEX, :3, 3]
    view, wanted = photographs(center + (1 + noise) * (POINTS - center)), WANTED
    method = SparseStereoDepth(smoothing=10, iterations=10, passes=3)
    found = sparse_stereo(view, wanted, method, key=jax.random.key(0))
    truth = jnp.asarray(DEPTHS[INDEX])
    before = depth_errors(wanted.scale(view) / found.diffused, truth)
    after = depth_errors(found.depth, truth)
    assert float(after.median) < 0.6 * float(before.median)
    assert float(after.mse) < 0.7 * float(before.mse)
    assert float(found.loss[-1]) < float(found.loss[0])
    # Three more per point, all at edges within the frame.
    assert int(found.model.valid.sum()) == 4 * 40


def test_errors_say_what_is_missing():
    none = Photographs(jnp.asarray(IMAGES), POSES, MATRIX)
    with pytest.raises(ValueError, match="have no sparse points"):
        seen_points(none, WANTED)
    behind = photographs(np.asarray([[0, 0, -3.0], [0, 0.1, -3.0]]))
    with pytest.raises(ValueError, match="no sparse point that the reference shows"):
        sparse_stereo(behind, WANTED, SparseStereoDepth(), key=jax.random.key(0))
    with pytest.raises(ValueError, match="`iterations` must be at least 1, got 0"):
        SparseStereoDepth(iterations=0)


def test_new_points_are_no_more_than_asked_for_and_fit_the_image():
    image = jax.random.uniform(jax.random.key(0), (12, 16, 3))
    model = DepthModel(
        jnp.zeros(2), jnp.zeros((2, 2)), jnp.zeros(2), jnp.zeros((12, 16)), jnp.ones(2, bool)
    )
    disparity = jnp.arange(192.0).reshape(12, 16)
    for count, kept in ((40, 40), (500, 192)):
        found = _with_edges(
            model, image, disparity, jnp.asarray(5), count=count, key=jax.random.key(1)
        )
        assert found.valid.shape == (2 + kept,)
        assert int(found.valid.sum()) == 2 + 5
        x, y = found.xy[2:7].astype(int).T
        assert_array_equal(found.disparity[2:7], disparity[y, x])
