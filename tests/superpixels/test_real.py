"""Superpixels of a real light field, its depth estimated."""

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import shared_data

from mvedge_jax.all_views import ViewDepth, depth_of_views
from mvedge_jax.datasets import load_light_field
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.metrics.superpixels import superpixel_scores
from mvedge_jax.superpixels import SuperpixelClustering, superpixels


@pytest.mark.slow
def test_cotton_is_cut_along_its_objects():
    scene = load_light_field(shared_data("hci", "cotton"), views=5).downsample(4)
    blind = scene.without_truth()
    result = EdgeDepth.for_light_field(blind)(blind)
    depths = depth_of_views(blind, result, ViewDepth.for_light_field(blind))
    model = SuperpixelClustering.for_depths(depths, choices={"size": 10.0})
    found = superpixels(blind, depths, model)
    labels = np.asarray(found.labels)
    assert (labels > 0).all()
    assert abs(len(np.unique(labels[2, 2])) / (128**2 / 100) - 1) < 0.05
    truth = scene.truth
    assert truth is not None
    assert truth.object_ids is not None
    scores = superpixel_scores(jnp.asarray(labels[2:3, 2:3]), truth.object_ids[None, None], None)
    assert float(scores.accuracy) > 0.98
    assert float(scores.compactness) > 0.4
