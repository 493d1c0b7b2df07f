"""The thesis' own maps of every view: what is projected, what guides fill, what is refused."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from all_views.cards import cards
from helpers import check_gradient
from scipy import ndimage

from experiments.peers.thesis_views import Guiding, thesis_views
from mvedge_jax.color import srgb_to_gray, srgb_to_lab
from mvedge_jax.edges import EdgePoints
from mvedge_jax.edges.sides import DirectionalDiffusion, bidirectional, thesis_response


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


def _slice(light, disparity, guides, middle):
    """One epipolar-plane image `[u, x]` of (6.4) to (6.8), by loops and a dense system.

    Args:
        light: L of the smoothed views, `[u, x]`.
        disparity: of the centre view's row.
        guides: `(x, d, weight, seen)` of the row's hidden points.
        middle: the centre view.
    """
    views, width = light.shape
    label, weight = np.zeros(light.shape), np.zeros(light.shape)
    for u in range(views):
        landed = np.full(width, -np.inf)
        for x, d in enumerate(disparity):
            there = int(np.floor(x + (middle - u) * d + 0.5))
            if 0 <= there < width:
                landed[there] = max(landed[there], d)
        hit = np.isfinite(landed)
        label[u] = np.where(hit, landed, 0)
        for x in np.flatnonzero(hit):
            # Lone pixels are noise; those of the centre view itself weigh less.
            if sum(hit[min(max(x + step, 0), width - 1)] for step in (-1, 0, 1)) > 1:
                weight[u, x] = 5 if u == middle else 15
        for x, d, own, seen in sorted(guides, key=lambda guide: guide[1]):
            there = int(np.floor(x + (middle - u) * d + 0.5))
            if seen[u] and 0 <= there < width:
                label[u, there], weight[u, there] = d, own
    along, across = (ndimage.sobel(light, axis, mode="nearest") for axis in (0, 1))
    smoothness = (0.1 / (along**2 + across**2 + 1e-5)).ravel()
    pixels = np.arange(light.size).reshape(light.shape)
    matrix = np.diag(weight.ravel())
    for first, second in ((pixels[:, :-1], pixels[:, 1:]), (pixels[:-1], pixels[1:])):
        for a, b in zip(first.ravel(), second.ravel(), strict=True):
            between = min(smoothness[a], smoothness[b])
            matrix[[a, b], [a, b]] += between
            matrix[[a, b], [b, a]] -= between
    return np.linalg.solve(matrix, (weight * label).ravel()).reshape(light.shape)


def test_every_slice_of_the_crosshair_minimises_its_energy():
    field = cards((3, 5, 14, 16), np.float64)
    rng = np.random.default_rng(1)
    disparity = np.asarray(field.truth.disparity) + 0.1 * rng.normal(size=(14, 16))
    xy = rng.integers(2, 12, (6, 2)).astype(float)
    label, visible = rng.uniform(-1, 1, 6), rng.random((6, 8)) < 0.6
    # Two of the points are seen in the centre view, and are no guides.
    visible[:, 1] = visible[:, 3 + 2] = np.arange(6) < 2
    points = _points(
        field, 6, xy=jnp.asarray(xy), disparity=jnp.asarray(label), visible=jnp.asarray(visible),
        valid=jnp.ones(6, bool),
    )  # fmt: skip
    params = Guiding()
    found = np.asarray(thesis_views(field, jnp.asarray(disparity), points, params))
    gray = srgb_to_gray(field.centre_view)
    passes = bidirectional(points, gray, DirectionalDiffusion(), respond=thesis_response)
    weight = np.exp(np.minimum(3 * np.asarray(passes.confidence), 4))
    assert weight.max() > 1
    light = np.asarray(srgb_to_lab(field.views)[..., 0])
    light = ndimage.gaussian_filter(light, 0.85, mode="nearest", axes=(2, 3), radius=2)
    for axis, first, arm, expected in (
        (1, 3, light[1], found[1]),
        (0, 0, light[:, 2].swapaxes(1, 2), found[:, 2].swapaxes(1, 2)),
    ):
        views = arm.shape[0]
        own = disparity if axis == 1 else disparity.T
        for row in range(arm.shape[1]):
            here = [
                (xy[n, 1 - axis], label[n], weight[n], visible[n, first : first + views])
                for n in range(2, 6)
                if xy[n, axis] == row
            ]
            solved = _slice(arm[:, row], own[row], here, views // 2)
            others = np.arange(views) != views // 2
            np.testing.assert_allclose(expected[others, row], solved[others], atol=1e-5)
