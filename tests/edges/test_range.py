"""The disparity range: the same whatever noise, gains and brightness do to the views."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from photometry.scenes import changed, cross_gains, textured

from mvedge_jax._paths import value_at
from mvedge_jax.all_views import ViewDepth, ViewDepths
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.edges._range import disparity_range
from mvedge_jax.lightfield import LightField
from mvedge_jax.superpixels import SuperpixelClustering


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


@pytest.mark.parametrize("known", [None, (-1.0, 1.0)])
def test_sizes_within_jit_are_refused_in_a_sentence(known):
    field = LightField(jnp.zeros((3, 3, 16, 16, 3)), disparity_range=known)
    name = "light_field" if known is None else "light_field.disparity_range"
    message = f"`{name}` is traced, as everything within `jit`.* make the model outside"
    for kind in (EdgeDepth, ViewDepth):
        with pytest.raises(TypeError, match=message):
            jax.jit(lambda f, kind=kind: kind.for_light_field(f))(field)
    closed = jax.jit(lambda x: x + value_at(EdgeDepth.for_light_field(field), "measurement.radius"))
    if known is not None:
        assert int(closed(1)) > 1
    flat = jnp.ones((3, 3, 8, 8))
    depths = ViewDepths(flat, flat, flat.astype(jnp.int8), jnp.asarray(0))
    with pytest.raises(TypeError, match="`depths` is traced"):
        jax.jit(lambda d: SuperpixelClustering.for_depths(d).margin)(depths)
