"""The thesis' own maps of every view: what is projected, what guides fill, what is refused."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from all_views.cards import cards
from scipy import ndimage

from experiments.peers.thesis_views import Guiding, thesis_views
from mvedge_jax.color import srgb_to_gray, srgb_to_lab
from mvedge_jax.edges import EdgePoints
from mvedge_jax.edges.sides import DirectionalDiffusion, bidirectional, thesis_response


def _points(field, count=1, **fields):
    views, dtype = sum(field.views.shape[:2]), field.views.dtype
    empty = EdgePoints(
        jnp.zeros((count, 2), dtype),
        jnp.zeros(count, dtype),
        jnp.ones(count, dtype),
        jnp.full(count, 0.01, dtype),
        jnp.tile(jnp.asarray([1.0, 0.0], dtype), (count, 1)),
        jnp.zeros((count, views), bool),
        jnp.zeros(count, bool),
    )
    return replace(empty, **fields)


def _slice(light, disparity, guides, middle):
    """One epipolar-plane image `[u, x]` of (6.4) to (6.8), by loops and a dense system.

    `guides` are `(x, d, weight, seen)` of the hidden points of a row of the center view.
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
            # Lone pixels are noise; those of the center view itself weigh less.
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


def test_every_slice_of_the_crosshair_minimizes_its_energy():
    field = cards((3, 5, 14, 16), np.float64)
    rng = np.random.default_rng(1)
    disparity = np.asarray(field.truth.disparity) + 0.1 * rng.normal(size=(14, 16))
    xy = rng.integers(2, 12, (6, 2)).astype(float)
    label, visible = rng.uniform(-1, 1, 6), rng.random((6, 8)) < 0.6
    # Two of the points are seen in the center view, and are no guides.
    visible[:, 1] = visible[:, 3 + 2] = np.arange(6) < 2
    points = _points(
        field, 6, xy=jnp.asarray(xy), disparity=jnp.asarray(label), visible=jnp.asarray(visible),
        valid=jnp.ones(6, bool),
    )  # fmt: skip
    params = Guiding()
    found = np.asarray(thesis_views(field, jnp.asarray(disparity), points, params))
    gray = srgb_to_gray(field.center_view)
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
