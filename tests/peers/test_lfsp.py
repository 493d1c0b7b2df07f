"""The thesis' superpixels: segments at their places, labels that follow surfaces."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.peers._lfsp_painting import Ends, painted
from experiments.peers._lfsp_views import propagated
from experiments.peers.lfsp import LfspParams, LfspSizes, thesis_superpixels
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics.superpixels import superpixel_scores


def _plane(slope, shape=(3, 3, 30, 40)):
    """A textured plane of one disparity, and a card before it at another."""
    rng = np.random.default_rng(0)
    far, near = np.repeat(np.repeat(rng.random((2, 20, 20, 3)), 4, 1), 4, 2)
    y, x = np.mgrid[: shape[2], : shape[3]]
    views, disparity = np.zeros((*shape, 3)), np.zeros(shape)
    for v, u in np.ndindex(shape[:2]):
        a, b = shape[1] // 2 - u, shape[0] // 2 - v
        on = (abs(y - b * slope - 15) < 8) & (abs(x - a * slope - 20) < 9)
        moved = near[(y - b * slope + 20) % 80, (x - a * slope + 20) % 80]
        views[v, u] = np.where(on[..., None], 0.3 * moved + [0.6, 0.1, 0], 0.5 * far[y, x])
        disparity[v, u] = np.where(on, slope, 0)
    return LightField(jnp.asarray(views, jnp.float32)), jnp.asarray(disparity, jnp.float32)


def _found(field, **choices):
    default = LfspParams()
    params = eqx.tree_at(lambda p: p.lines, default, replace(default.lines, capacity=48))
    return thesis_superpixels(field, params, LfspSizes(size=10, **choices))


@pytest.mark.parametrize("slope", [1, pytest.param(-1, marks=pytest.mark.slow)])
def test_labels_keep_to_surfaces_in_all_views(slope):
    field, disparity = _plane(slope)
    labels = _found(field)
    ids = (disparity != 0).astype(jnp.int32)
    scores = superpixel_scores(labels, ids, disparity)
    assert float(scores.accuracy) > 0.9
    assert float(scores.unlabelled) == 0
    assert float(scores.inconsistent) < 0.06


@pytest.mark.parametrize("steps", [(0, 0), (1, 0), (-2, 1)])
def test_segments_are_drawn_nearest_on_top_where_views_show_them(steps):
    epi = np.array([2.0, 2.0, 3.0])
    left = np.array([[1.0, 0.0], [4.5, 1.0], [2.0, -1.0]])
    right = np.array([[9.0, 0.0], [7.0, 1.0], [3.0, -1.0]])
    ends, disparity = Ends.of(epi, left, right), jnp.asarray(left[:, 1])
    drawn = painted(ends, disparity, jnp.asarray(steps, float), shape=(8, 12), width=16)
    wanted = np.full((8, 12), -1)
    for k in (2, 0, 1):
        row = int(epi[k] + steps[1] * left[k, 1])
        first, last = (line[k, 0] + steps[0] * line[k, 1] for line in (left, right))
        columns = np.arange(12)
        wanted[row, (columns >= first) & (columns < last)] = k
    np.testing.assert_array_equal(drawn, wanted)


@pytest.mark.parametrize("clamped", [False, True])
def test_what_the_centre_finds_goes_to_all_views_and_what_leaves_them_is_dropped(clamped):
    labels = np.ones((3, 3, 12, 16), np.int32)
    labels[1, 1, 5, 7:9], labels[1, 1, 5, 14:] = [7, 0], [0, 7]
    labels[1, [0, 2], 5, [10, 6]] = labels[1, 0, 5, 15] = 0
    lab = jnp.full((*labels.shape, 3), 60.0).at[1, 1, 5, jnp.array([7, 8, 14, 15])].set(0.0)
    # The last filling prefers the pixel below, by its color.
    lab = lab.at[1, 0, 5:7, 15].set(20.0)
    steps, disparity = LightField(lab / 100).steps, jnp.full(labels.shape, 2.0)
    found = propagated(jnp.asarray(labels), disparity, lab, steps, swapped=False, clamped=clamped)
    assert [int(found[1, u, 5, 8 + 2 * (1 - u)]) for u in range(3)] == [7, 7, 7]
    assert int(found[0, 1, 5, 8]) == 1  # other rows of views show it elsewhere
    assert int(found[1, 1, 5, 14]) == 7
    assert int(found[1, 0, 5, 15]) == (7 if clamped else 1)


def test_bad_input_is_named():
    field, _ = _plane(1)
    part = LightField(field.views, available=jnp.ones((3, 3), bool).at[0, 0].set(False))
    for make, message in (
        (lambda: _found(LightField(field.views[:1])), "odd numbers of rows and columns of views"),
        (lambda: _found(part), "must have all of its views, 1 are missing"),
        (lambda: LfspSizes(bugs=("typo",)), "`bugs` must be of steep, .*, got typo"),
        (lambda: LfspSizes(size=0), "`size` must be at least 1, got 0"),
    ):
        with pytest.raises(ValueError, match=message):
            make()
