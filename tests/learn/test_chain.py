"""Learning through the whole chain, small."""

import jax
import numpy as np
import optax
import pytest

from mvedge_jax import EdgeDepth
from mvedge_jax.datasets.synthetic import random_scenes
from mvedge_jax.learn import RobustLoss, learn

SMALL = {"refine.sharpen.levels": 6, "refine.sharpen.radius": 2, "refine.slopes": None}


@pytest.mark.slow
def test_numbers_of_the_chain_learn():
    key = jax.random.key(0)
    scenes = random_scenes.random_light_fields(
        shape=(3, 3, 24, 28), count=3, disparity_range=(-1.0, 1.0), key=key
    )
    model = EdgeDepth.for_light_field(scenes[0].without_truth(), preset="edges", choices=SMALL)
    found = learn(
        model,
        ["smoothness", "labels", "refine.precision"],
        scenes,
        validation=scenes,
        loss=RobustLoss((0.1,)),
        optimizer=optax.adam(0.05),
        steps=12,
        batch=3,
        check_every=3,
        limit=1.0,
        key=key,
    )
    checks = dict(found.validation)
    assert checks[found.best_step] < 0.97 * checks[0]
    np.testing.assert_array_equal(
        np.asarray(found.model.refine.parted), np.asarray(model.refine.parted)
    )
    assert found.factors()["smoothness.color"] != 1
