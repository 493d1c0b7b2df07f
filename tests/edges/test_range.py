"""The disparity range: the same whatever noise, gains and brightness do to the views."""

import numpy as np
import pytest
from photometry.scenes import changed, cross_gains, textured

from mvedge_jax.edges._range import disparity_range


@pytest.fixture(scope="module")
def scene():
    return textured(size=(256, 256), disparity=0.9, blob=1.5)


@pytest.fixture(scope="module")
def clean_range(scene):
    return disparity_range(changed(scene))


@pytest.mark.parametrize(
    "change",
    [
        {"noise": 0.02},
        {"noise": 0.03},
        {"gain": cross_gains()},
        {"factor": 0.1},
        {"factor": 0.2, "noise": 0.004, "gain": cross_gains()},
    ],
    ids=["noise", "strong noise", "gains", "dark", "all"],
)
def test_the_range_withstands(scene, clean_range, change):
    low, high = clean_range
    assert low < 0.9 < high
    found = disparity_range(changed(scene, **change))
    np.testing.assert_allclose(found, clean_range, atol=0.25)
