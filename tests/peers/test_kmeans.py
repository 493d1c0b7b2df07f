"""k-means superpixels: the clustering against loops, labels in all views, holes."""

import inspect

import jax.numpy as jnp
import numpy as np
import pytest

from experiments.peers.kmeans import KMeansParams, KMeansSizes, kmeans_superpixels
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.lightfield import LightField


def _scene(shape=(1, 3, 14, 18)):
    rng = np.random.default_rng(0)
    views = jnp.asarray(rng.random((*shape, 3)))
    x = np.arange(shape[3])
    disparity = np.broadcast_to(np.where(abs(x - 9) < 4, 2.0, 0.0), shape[2:])
    return LightField(views), jnp.asarray(disparity)


def _loops(lab, disparity, size, rounds):
    """Labels of the centre view, written as the definition."""
    height, width = disparity.shape
    z = (disparity - disparity.min()) / np.ptp(disparity)
    pixels = [(np.array([x, y]), z[y, x], lab[y, x]) for y in range(height) for x in range(width)]
    centres = [
        pixels[y * width + x]
        for y in range(size // 2, height // size * size, size)
        for x in range(size // 2, width // size * size, size)
    ]

    def cost(p, c):
        away, color = np.linalg.norm(p[0] - c[0]), np.linalg.norm(p[2] - c[2])
        return away + 120 * abs(p[1] - c[1]) + 2 * color

    labels: list[int] = []
    for k in range(rounds):
        labels = [int(np.argmin([cost(p, c) for c in centres])) for p in pixels]
        if k < rounds - 1:
            groups = [[p for p, j in zip(pixels, labels, strict=True) if j == i]
                      for i in range(len(centres))]  # fmt: skip
            centres = [tuple(np.mean([p[n] for p in g], axis=0) for n in range(3)) for g in groups]
    return 1 + np.array(labels).reshape(height, width)


def test_clusters_are_those_of_loops_and_labels_move_with_their_disparity():
    field, disparity = _scene()
    sizes = KMeansSizes(size=6, rounds=3)
    found = np.asarray(kmeans_superpixels(field, disparity, KMeansParams(), sizes))
    lab, centre = np.asarray(srgb_to_lab(field.centre_view)), found[0, 1]
    np.testing.assert_array_equal(centre, _loops(lab, np.asarray(disparity), 6, 3))
    np.testing.assert_array_equal(found[0, 0][:, 8:15], centre[:, 6:13])
    np.testing.assert_array_equal(found[0, 2][:, 4:11], centre[:, 6:13])
    assert (found > 0).all()  # holes are filled


def test_bad_input_is_named():
    field, disparity = _scene()
    with pytest.raises(ValueError, match="`disparity` must have the size of the views, 14x18"):
        inspect.unwrap(kmeans_superpixels)(field, disparity[:5], KMeansParams(), KMeansSizes())
    with pytest.raises(ValueError, match="`size` must be at least 1, got 0"):
        KMeansSizes(size=0)
