"""Random scenes: truth of all views agrees, one program renders them, a key is a scene."""

import inspect
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import map_coordinates, maximum_filter, minimum_filter

from mvedge_jax.datasets import synthetic
from mvedge_jax.datasets.synthetic import _trace, random_scenes

pytestmark = pytest.mark.usefixtures("optimised")
SHAPE = (3, 3, 40, 44)
RANGES = (None, (-2.0, 2.0), (0.5, 1.5), (-3.0, -2.0), (-5.0, 5.0), None)


renderer: Any = _trace.trace_view


def scene_of(number, **options):
    return random_scenes.random_scene(key=jax.random.key(number), **options)


def render(scene, number=0):
    return synthetic.render(scene, shape=SHAPE, samples=2, key=jax.random.key(number))


@pytest.fixture(scope="module")
def programs():
    """Programs that the renderer had before `scenes`."""
    return renderer._cache_size()


@pytest.fixture(scope="module")
def scenes(programs):
    made = [scene_of(k, disparity_range=limits) for k, limits in enumerate(RANGES)]
    return [(scene, render(scene, k)) for k, scene in enumerate(made)]


def test_one_program_renders_all_scenes(programs, scenes):
    assert len({int(scene.world.solids.count) for scene, _ in scenes}) > 1
    assert renderer._cache_size() == programs + 1


def test_every_view_shows_the_range_and_nothing_beyond(scenes):
    for (scene, field), given in zip(scenes, RANGES, strict=True):
        low, high = np.asarray(scene.disparity_range)
        if given is not None:
            np.testing.assert_allclose((low, high), given, rtol=1e-6)
        assert 0.99 < high - low < 10.01
        disparity = np.asarray(field.truth.view_disparity)
        assert low < disparity.min() < low + 0.3 * (high - low)
        assert disparity.max() < high
        assert (np.asarray(field.truth.view_ids) > 0).all(), "no sky"


def test_a_visible_point_has_one_color_disparity_and_id_in_every_view(scenes):
    for scene, field in scenes:
        disparity = np.asarray(field.truth.disparity)
        y, x = np.mgrid[: SHAPE[2], : SHAPE[3]]
        for v, u in ((0, 0), (1, 2), (2, 1)):
            shown = np.asarray(
                synthetic.visibility(scene, shape=SHAPE, source=(1, 1), target=(v, u))
            )
            place = np.stack([y - (v - 1) * disparity, x - (u - 1) * disparity])

            def there(image, place=place, order=0):
                return map_coordinates(image, place, order=order, mode="nearest")

            # The nearest pixel centre may lie over an edge, and beside a bar that is thinner.
            around = np.asarray(field.truth.view_disparity[v, u])
            slack = 0.02 * float(scene.disparity_range[1] - scene.disparity_range[0])
            lowest, highest = there(minimum_filter(around, 3)), there(maximum_filter(around, 3))
            fits = (lowest - slack <= disparity) & (disparity <= highest + slack)
            assert fits[shown].mean() > 0.98
            ids = there(np.asarray(field.truth.view_ids[v, u]))
            same = shown & (ids == np.asarray(field.truth.object_ids))
            assert int(same.sum()) > 0.85 * int(shown.sum())
            seen = there(np.asarray(field.views[v, u, :, :, 1]), order=1)
            difference = np.abs(seen - np.asarray(field.centre_view[..., 1]))[same]
            assert np.median(difference) < 0.03


def test_a_key_is_a_scene_and_splits_share_none(scenes):
    (scene, field), options = scenes[1], {"disparity_range": RANGES[1]}
    again = scene_of(1, **options)
    assert all(map(np.array_equal, jax.tree.leaves(scene), jax.tree.leaves(again)))
    np.testing.assert_array_equal(render(again, 1).views, field.views)
    others = [scene_of(1, split=split, **options) for split in ("validation", "test")]
    others.append(scene_of(2, **options))
    seeds = {int(other.world.surfaces.seed) for other in [scene, *others]}
    assert len(seeds) == 4


def test_sensors_have_8_or_10_bits(scenes):
    found = set()
    for scene, field in scenes:
        levels = float(scene.sensor.levels)
        found.add(levels)
        steps = np.asarray(field.views, np.float64) * levels
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)
    assert found <= {255.0, 1023.0}


def test_further_lamps_brighten_and_cast_no_shadow():
    card = synthetic.plane((0.0, 0.0, 4.0), (9.0, 9.0))
    dark = synthetic.make_world([card], lamp_strength=0.0)
    lamp = ((0.3, -0.2, -1.0), (0.2, 0.2, 0.2))
    lit = synthetic.make_world([card], lamp_strength=0.0, fills=[lamp])
    images = [
        render(synthetic.make_scene(world, disparity_range=(-1.0, 1.0))).centre_view
        for world in (dark, lit)
    ]
    assert float(images[1].mean()) > 1.1 * float(images[0].mean())


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
    with pytest.raises(ValueError, match="`count` must be at least 1, got 0"):
        random_scenes.random_light_fields(shape=SHAPE, count=0, key=jax.random.key(0))
    with pytest.raises(ValueError, match="`shape` must have odd numbers of view rows"):
        random_scenes.random_light_fields(shape=(4, 4, 9, 9), count=1, key=jax.random.key(0))


def test_double_precision_reaches_the_views():
    scene = scene_of(0, dtype=jnp.float64)
    assert scene.world.solids.centre.dtype == jnp.float64
    leaves = jax.tree.leaves(scene)
    assert {leaf.dtype for leaf in leaves if jnp.issubdtype(leaf.dtype, jnp.floating)} == {
        jnp.dtype(jnp.float64)
    }
