"""Random scenes: views of a range and nothing beyond, one program, a key is a scene."""

import inspect
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mvedge_jax.datasets import synthetic
from mvedge_jax.datasets.synthetic import _trace, random_scenes

pytestmark = pytest.mark.usefixtures("optimized")
SHAPE = (3, 3, 40, 44)
RANGES = (None, (-2.0, 2.0), (0.5, 1.5), (-3.0, -2.0), (-5.0, 5.0), None)


def scene_of(number, **options):
    return random_scenes.random_scene(key=jax.random.key(number), **options)


def render(scene, number=0):
    return synthetic.render(scene, shape=SHAPE, samples=2, key=jax.random.key(number))


@pytest.fixture(scope="module")
def scenes():
    """Scenes and light fields, which share one program, as scenes without their sensor do."""
    renderer: Any = _trace.trace_view
    before = renderer._cache_size()
    made = [scene_of(k, disparity_range=limits) for k, limits in enumerate(RANGES)]
    fields = [(scene, render(scene, k)) for k, scene in enumerate(made)]
    assert len({int(scene.world.solids.count) for scene in made}) > 1
    assert renderer._cache_size() == before + 1
    render(synthetic.scene("edges"))
    cards = synthetic.make_world([synthetic.plane((0.0, 0.0, 3.0), (9.0, 9.0))] * 5, shadow=0.3)
    render(synthetic.make_scene(cards, disparity_range=(0.0, 3.0), focal=1.1, focus=2.5))
    assert renderer._cache_size() == before + 2
    return fields


def test_every_view_shows_the_range_and_nothing_beyond(scenes):
    for (scene, field), given in zip(scenes, RANGES, strict=True):
        low, high = np.asarray(scene.disparity_range)
        if given is not None:
            assert_allclose((low, high), given, rtol=1e-6)
        assert 0.99 < high - low < 10.01
        disparity = np.asarray(field.truth.view_disparity)
        assert low < disparity.min() < low + 0.3 * (high - low)
        assert disparity.max() < high
        assert (np.asarray(field.truth.view_ids) > 0).all(), "no sky"


def test_sensors_have_8_or_10_bits(scenes):
    for scene, field in scenes:
        levels = float(scene.sensor.levels)
        assert levels in (255.0, 1023.0)
        steps = np.asarray(field.views, np.float64) * levels
        assert_allclose(steps, np.round(steps), atol=1e-3)


def test_a_key_is_a_scene_and_splits_share_none(scenes):
    (scene, field), options = scenes[1], {"disparity_range": RANGES[1]}
    again = scene_of(1, **options)
    assert all(map(np.array_equal, jax.tree.leaves(scene), jax.tree.leaves(again)))
    assert_array_equal(render(again, 1).views, field.views)
    others = [scene_of(1, split=split, **options) for split in ("validation", "test")]
    others.append(scene_of(2, **options))
    assert len({int(other.world.surfaces.seed) for other in [scene, *others]}) == 4


def test_light_fields_are_rendered_when_they_are_read():
    fields = random_scenes.random_light_fields(
        shape=SHAPE, split="test", count=100, disparity_range=(-1.0, 1.0), key=jax.random.key(5)
    )
    assert len(fields) == 100
    assert fields[-1] is fields[99]
    assert fields[99].name == "test scene 99"
    assert not np.array_equal(fields[98].views, fields[99].views)
    assert len(fields[3:5]) == 2
    with pytest.raises(IndexError):
        fields[100]


def test_mistakes_are_named():
    plain: Any = inspect.unwrap(random_scenes.random_scene)
    with pytest.raises(ValueError, match=r"`split` must be one of .*, got 'val'"):
        plain(split="val", key=jax.random.key(0))
    for limits in ((1.0, 1.0), (0.0, float("nan"))):
        with pytest.raises(ValueError, match=r"`disparity_range` must be \(low, high\), finite"):
            scene_of(0, disparity_range=limits)


def test_double_precision_reaches_the_views():
    leaves = jax.tree.leaves(scene_of(0, dtype=jnp.float64))
    floating = {leaf.dtype for leaf in leaves if jnp.issubdtype(leaf.dtype, jnp.floating)}
    assert floating == {jnp.dtype(jnp.float64)}


def test_parts_of_scenes_look_like_crops_of_larger_views():
    options: Any = {"split": "test", "count": 2, "disparity_range": (-1.0, 1.0)}
    fields: Any = random_scenes.random_light_fields(
        shape=SHAPE, zoom=(2.0, 4.0), views="crosshair", key=jax.random.key(5), **options
    )
    whole: Any = random_scenes.random_light_fields(shape=SHAPE, key=jax.random.key(5), **options)
    part, other = np.asarray(fields[1].truth.disparity), np.asarray(whole[1].truth.disparity)
    assert part.min() >= -1
    assert part.max() <= 1
    assert set(np.unique(fields[1].truth.object_ids)) <= set(np.unique(whole[1].truth.object_ids))
    assert np.abs(np.diff(part)).mean() < np.abs(np.diff(other)).mean()
    with pytest.raises(ValueError, match=r"`zoom` must be a range of factors of at least 1, got"):
        random_scenes.random_light_fields(
            shape=SHAPE, zoom=(0.5, 1.0), key=jax.random.key(0), **options
        )
