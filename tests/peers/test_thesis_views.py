"""The thesis' own maps of every view: what is projected, what guides fill, what is refused."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from all_views.cards import cards
from helpers import check_gradient

from experiments.peers.thesis_views import Guiding, thesis_views
from mvedge_jax.edges import EdgePoints


def _points(field, count=1, **fields):
    views = sum(field.views.shape[:2])
    dtype = field.views.dtype
    empty = EdgePoints(
        jnp.zeros((count, 2), dtype),
        jnp.zeros(count, dtype),
        jnp.ones(count, dtype),
        jnp.full(count, 0.01, dtype),
        jnp.tile(jnp.asarray([1.0, 0.0], dtype), (count, 1)),
        jnp.zeros((count, views), bool),
        jnp.zeros(count, bool),
    )
    return EdgePoints(**{**{n: getattr(empty, n) for n in empty.__dataclass_fields__}, **fields})


def test_what_the_centre_shows_is_moved_and_the_rest_lies_between():
    field = cards()
    truth = np.asarray(field.truth.view_disparity)
    found = np.asarray(thesis_views(field, field.truth.disparity, _points(field), Guiding()))
    np.testing.assert_array_equal(found[2, 2], truth[2, 2])
    assert np.isfinite(found).all()
    # A diffusion makes nothing that is nearer or farther than its labels.
    assert found.min() > -1.001
    assert found.max() < 1.001
    error = np.abs(found - truth)
    assert np.median(error) < 1e-3
    assert (error > 0.1).mean() < 0.2


def test_guides_bring_surfaces_that_the_centre_view_does_not_show():
    # A third, middle surface is all around the places that the card uncovers in the rightmost view.
    field = cards()
    rows = np.arange(12, 29)
    xy = np.stack([np.full(rows.size, 37.0), rows], -1)
    visible = np.zeros((rows.size, 10), bool)
    visible[:, 5] = True
    guides = _points(
        field,
        rows.size,
        xy=jnp.asarray(xy, field.views.dtype),
        disparity=jnp.full(rows.size, -0.5, field.views.dtype),
        visible=jnp.asarray(visible),
        valid=jnp.ones(rows.size, bool),
    )
    disparity = field.truth.disparity
    with_guides = thesis_views(field, disparity, guides, Guiding())
    without = thesis_views(field, disparity, _points(field, rows.size), Guiding())
    # They are seen in the leftmost view of the centre row alone, at x = 37 - 2 * .5.
    changed = np.abs(np.asarray(with_guides - without)) > 0.1
    assert changed[2, 0, 12:29, 36].mean() > 0.9
    assert not changed[:, 2].any()


@pytest.mark.parametrize("grid", [(1, 5), (5, 1), (3, 5)])
def test_any_grid(grid):
    field = cards((*grid, 33, 40))
    found = thesis_views(field, field.truth.disparity, _points(field), Guiding())
    assert found.shape == field.views.shape[:4]
    assert float(jnp.median(jnp.abs(found - field.truth.view_disparity))) < 1e-3


def test_derivatives_equal_differences():
    field = cards((3, 3, 16, 20), np.float64)
    weights = jax.random.normal(jax.random.key(1), field.views.shape[:4])
    disparity = field.truth.disparity + 0.01

    def loss(disparity):
        return jnp.sum(weights * thesis_views(field, disparity, _points(field), Guiding()))

    check_gradient(loss, disparity, rtol=1e-4, step=1e-6, directions=1, key=jax.random.key(2))


def test_other_sizes_are_refused():
    field = cards()
    run = inspect.unwrap(thesis_views)
    with pytest.raises(ValueError, match="`disparity` must have the size of the views, 40x48"):
        run(field, jnp.zeros((8, 8)), _points(field), Guiding())
    other = _points(cards((3, 3, 40, 48)))
    with pytest.raises(ValueError, match="`points.visible` must tell of 10 views"):
        run(field, field.truth.disparity, other, Guiding())
