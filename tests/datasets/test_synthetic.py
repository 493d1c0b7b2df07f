"""The renderer against closed forms: disparity, ids, occlusion, photo-consistency."""

import itertools
import resource
import time
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import map_coordinates, maximum_filter, minimum_filter

from experiments.peers import photographs
from mvedge_jax.datasets import synthetic
from mvedge_jax.datasets.synthetic import _scenes, _trace
from mvedge_jax.datasets.synthetic.world import Material

pytestmark = pytest.mark.usefixtures("optimised")
KEY = jax.random.key(0)
# Few sizes, so that few functions are compiled.
SMALL = (3, 5, 60, 54)  # one ray per pixel
PICTURE = (3, 3, 150, 176)  # nine rays per pixel
PLAIN = Material(dark=(0.5, 0.5, 0.5), light=(0.5, 0.5, 0.5), contrast=0.0)
DARK = replace(PLAIN, dark=(0.1, 0.1, 0.1), light=(0.1, 0.1, 0.1))
BLACK = replace(PLAIN, dark=(0.0, 0.0, 0.0), light=(0.0, 0.0, 0.0))
FOCAL, GAIN, FOCUS = 1.4, 20.0, 4.0


def render(scene, **options) -> Any:  # Any: the truth is there
    return synthetic.render(scene, **options)


def render_posed(scene, poses, intrinsics, **options) -> Any:
    return photographs.render_posed(scene, poses, intrinsics, **options)


def exact(*solids, **light):
    """A float64 scene and its light field."""
    world = synthetic.make_world(list(solids), dtype=jnp.float64, **light)
    scene = synthetic.make_scene(world, disparity_range=(-5.0, 5.0))
    return scene, render(scene, shape=SMALL, samples=1, key=KEY)


def rays(shape, v, u):
    """Origin and directions (z = 1) of a view of the default rig, from the documentation alone."""
    rows, columns, height, width = shape
    focal = FOCAL * max(height, width)
    y, x = np.mgrid[:height, :width].astype(float)
    du, dv = u - columns // 2, v - rows // 2
    direction = np.stack(
        [
            (x - (width - 1) / 2 - du * GAIN / FOCUS) / focal,
            (y - (height - 1) / 2 - dv * GAIN / FOCUS) / focal,
            np.ones_like(x),
        ],
        axis=-1,
    )
    return np.array([du, dv, 0.0]) * GAIN / focal, direction


def disparity_of(depth):
    return GAIN * (1 / depth - 1 / FOCUS)


def every_view(shape):
    return itertools.product(range(shape[0]), range(shape[1]))


@pytest.fixture(scope="module")
def pictures():
    """Every named scene without noise, small."""
    return {
        name: (scene := synthetic.scene(name), render(scene, shape=PICTURE, key=KEY))
        for name in synthetic.scene_names()
        if name != "noisy"
    }


def test_disparity_of_a_slanted_plane_is_exact_in_every_view():
    axes = synthetic.rotation(yaw=35.0, pitch=-20.0, roll=10.0)
    centre = np.array([0.2, -0.1, 4.5])
    _, light_field = exact(synthetic.plane((0.2, -0.1, 4.5), (90.0, 90.0), axes=axes))
    normal = np.array(axes[2])
    for v, u in every_view(SMALL):
        origin, direction = rays(SMALL, v, u)
        depth = normal @ (centre - origin) / (direction @ normal)
        np.testing.assert_allclose(
            light_field.truth.view_disparity[v, u], disparity_of(depth), atol=1e-12
        )
    # In the centre view it is an affine function of the pixel.
    d = np.asarray(light_field.truth.disparity)
    np.testing.assert_allclose(d[:, 2:] - 2 * d[:, 1:-1] + d[:, :-2], 0.0, atol=1e-12)


def test_disparity_of_a_sphere_is_exact_in_every_view():
    centre, radius = np.array([0.1, 0.05, 3.6]), 0.8
    wall = synthetic.plane((0.0, 0.0, 6.0), (99.0, 99.0))
    _, light_field = exact(wall, synthetic.sphere((0.1, 0.05, 3.6), radius))
    for v, u in every_view(SMALL):
        origin, d = rays(SMALL, v, u)
        a, b = (d * d).sum(-1), d @ (origin - centre)
        square = b * b - a * ((origin - centre) @ (origin - centre) - radius**2)
        hit = square > 0
        depth = np.where(hit, (-b - np.sqrt(np.maximum(square, 0))) / a, 6.0)
        np.testing.assert_array_equal(light_field.truth.view_ids[v, u], np.where(hit, 2, 1))
        np.testing.assert_allclose(
            light_field.truth.view_disparity[v, u], disparity_of(depth), atol=1e-12
        )
        assert hit.any()
        assert not hit.all()


def test_points_on_boxes_and_bars_lie_on_their_surfaces():
    axes = synthetic.rotation(yaw=30.0, pitch=15.0, roll=5.0)
    start, stop, radius = np.array([-0.9, -0.3, 3.2]), np.array([0.7, 0.5, 3.9]), 0.12
    scene, light_field = exact(
        synthetic.plane((0.0, 0.0, 9.0), (99.0, 99.0)),
        synthetic.box((0.5, -0.2, 5.0), (1.6, 1.4, 1.0), axes=axes),
        synthetic.bar((-0.9, -0.3, 3.2), (0.7, 0.5, 3.9), radius),
    )
    camera = light_field.camera
    for v, u in every_view(SMALL):
        origin, direction = rays(SMALL, v, u)
        depth = np.asarray(camera.depth(light_field.truth.view_disparity[v, u]))
        point = origin + direction * depth[..., None]
        ids = np.asarray(light_field.truth.view_ids[v, u])
        local = np.abs((point[ids == 2] - [0.5, -0.2, 5.0]) @ np.array(axes).T)
        np.testing.assert_allclose((local - [0.8, 0.7, 0.5]).max(-1), 0.0, atol=1e-12)
        along = stop - start
        t = np.clip((point[ids == 3] - start) @ along / (along @ along), 0, 1)
        distance = np.linalg.norm(point[ids == 3] - start - t[:, None] * along, axis=-1)
        np.testing.assert_allclose(distance, radius, atol=1e-12)
        assert {1, 2, 3} == set(np.unique(ids))
    assert scene.world.solids.count == 3


def test_sky_is_at_infinity():
    _, light_field = exact(synthetic.sphere((0.0, 0.0, 4.0), 0.5))
    sky = np.asarray(light_field.truth.object_ids) == 0
    assert sky.any()
    np.testing.assert_allclose(light_field.truth.disparity[sky], -GAIN / FOCUS)
    assert np.isinf(np.asarray(light_field.camera.depth(light_field.truth.disparity))[sky]).all()


def test_single_precision_is_close():
    """The figure: 2e-5 px, wherever both see the same solid."""
    _, double = exact(*_recipe("demo"))
    world = synthetic.make_world(_recipe("demo"), dtype=jnp.float32)
    scene = synthetic.make_scene(world, disparity_range=(-5.0, 5.0))
    single = render(scene, shape=SMALL, samples=1, key=KEY)
    assert single.views.dtype == jnp.float32
    assert single.truth.view_disparity.dtype == jnp.float32
    same = np.asarray(single.truth.view_ids == double.truth.view_ids)
    assert same.mean() > 0.999
    error = np.abs(
        np.asarray(single.truth.view_disparity, float) - np.asarray(double.truth.view_disparity)
    )
    assert error[same].max() < 1e-4
    assert np.median(error[same]) < 2e-6


def _recipe(name):
    return list(_scenes._RECIPES[name]().solids)


def _warp(light_field, source, target, values, order):
    """Where the source's pixels are in the target, and what is there."""
    d = np.asarray(light_field.truth.view_disparity[source], float)
    y, x = np.mgrid[: d.shape[0], : d.shape[1]].astype(float)
    x, y = x + (source[1] - target[1]) * d, y + (source[0] - target[0]) * d
    return np.stack(
        [
            map_coordinates(values[..., c], [y, x], order=order, mode="nearest")
            for c in range(values.shape[-1])
        ],
        axis=-1,
    )


def photo_error(scene, light_field, source, target):
    """Absolute errors of 255 over what both views see; cubic interpolation."""
    shape = light_field.views.shape[:4]
    seen = np.asarray(synthetic.visibility(scene, shape=shape, source=source, target=target))
    there, own = (np.asarray(light_field.views[k], float) * 255 for k in (target, source))
    right = np.abs(_warp(light_field, source, target, there, 3) - own)[seen]
    wrong = np.abs(_warp(light_field, target, source, there, 3) - own)[seen]
    return right, wrong


# The still life is all detail at this size; it is shown at 512 px below.
@pytest.mark.parametrize("name", [n for n in synthetic.scene_names() if n not in {"noisy", "demo"}])
def test_any_view_warps_to_any_other(pictures, name):
    """Must show 3: median error below 0.5/255 over unoccluded pixels."""
    for source, target in [((1, 1), (0, 2)), ((0, 0), (2, 2)), ((2, 1), (1, 1))]:
        scene, light_field = pictures[name]
        right, wrong = photo_error(scene, light_field, source, target)
        assert np.median(right) < 0.5
        if name != "textureless":
            assert wrong.mean() > 2 * right.mean()


@pytest.mark.parametrize("name", ["edges", "wide", "demo"])
def test_visibility_agrees_with_the_truth_of_the_other_view(pictures, name):
    """Ids are consistent: seen is the same solid at the same disparity, hidden is behind another.

    Judged where the target's 3x3 pixels around the point all see one solid, which is proof but for
    what fits between pixels (a ridge of a box, the rim of a hole).
    """
    scene, light_field = pictures[name]
    truth = light_field.truth
    hidden_pixels = 0
    for source, target in [((1, 1), (0, 2)), ((2, 2), (0, 0))]:
        seen = np.asarray(synthetic.visibility(scene, shape=PICTURE, source=source, target=target))
        ids, d = (np.asarray(a[target]) for a in (truth.view_ids, truth.view_disparity))
        own_ids, own = (np.asarray(a[source]) for a in (truth.view_ids, truth.view_disparity))
        y, x = np.mgrid[: d.shape[0], : d.shape[1]].astype(float)
        x, y = x + (source[1] - target[1]) * own, y + (source[0] - target[0]) * own
        height, width = d.shape
        inside = (x > 1) & (x < width - 2) & (y > 1) & (y < height - 2)
        xi, yi = (np.clip(np.round(a).astype(int), 0, n - 1) for a, n in ((x, width), (y, height)))
        uniform = (maximum_filter(ids, 3) == minimum_filter(ids, 3))[yi, xi] & inside
        low, high = minimum_filter(d, 3)[yi, xi], maximum_filter(d, 3)[yi, xi]
        there = ids[yi, xi]
        assert (there == own_ids)[seen & uniform].mean() > 0.9995
        near = (own >= low - 1e-3) & (own <= high + 1e-3)
        assert near[seen & uniform].mean() > 0.99
        assert ((own >= low - 0.1) & (own <= high + 0.1))[seen & uniform].mean() > 0.9995
        hidden = ~seen & uniform & (there != own_ids)
        assert (d[yi, xi] > own)[hidden].all()
        assert seen[uniform & (there == own_ids) & near].mean() > 0.995
        hidden_pixels += hidden.sum()
        # Outside of the frame nothing is seen.
        outside = (x < -0.5) | (x > width - 0.5) | (y < -0.5) | (y > height - 0.5)
        assert not seen[outside].any()
    assert hidden_pixels > 20


def test_a_view_sees_itself(pictures):
    scene, _ = pictures["demo"]
    seen = synthetic.visibility(scene, shape=PICTURE, source=(0, 2), target=(0, 2))
    assert bool(seen.all())


@pytest.mark.parametrize("name", synthetic.scene_names())
def test_named_scenes_keep_their_promises(name):
    """Truth within the range, several solids, a picture that is neither dark nor burnt out."""
    light_field = render(synthetic.scene(name), shape=SMALL, samples=1, key=KEY)
    low, high = np.asarray(light_field.disparity_range)
    disparity = np.asarray(light_field.truth.view_disparity)
    assert disparity.min() >= low
    assert disparity.max() <= high
    # Not much room to spare either: a search over the range is not wasted.
    assert disparity.min() < low + 0.5
    assert disparity.max() > high - 0.5
    assert len(np.unique(light_field.truth.object_ids)) >= 2
    assert 0.25 < float(light_field.views.mean()) < 0.75
    assert light_field.name == name
    if name == "wide":
        assert disparity.min() < -3.4
        assert disparity.max() > 3.4


def test_truth_is_the_same_at_any_resolution_and_number_of_samples():
    scene = synthetic.scene("demo")
    # An even number of samples has none in the pixel's centre: the truth takes one more ray.
    small = render(scene, shape=(1, 1, 20, 18), samples=2, key=KEY)
    large = render(scene, shape=(1, 1, *SMALL[2:]), samples=1, key=KEY)
    np.testing.assert_array_equal(small.truth.object_ids, large.truth.object_ids[1::3, 1::3])
    np.testing.assert_allclose(small.truth.disparity, large.truth.disparity[1::3, 1::3], atol=1e-4)


def test_camera_and_crop_agree_with_the_truth(pictures):
    _, light_field = pictures["demo"]
    depth = light_field.camera.depth(light_field.truth.disparity)
    np.testing.assert_allclose(depth[0, 0], 1 / (0.25 - 1.35 / 20), rtol=1e-5)
    np.testing.assert_array_equal(
        light_field.truth.disparity, light_field.truth.view_disparity[1, 1]
    )
    np.testing.assert_array_equal(light_field.truth.object_ids, light_field.truth.view_ids[1, 1])
    assert light_field.truth.valid.all()
    assert light_field.crop_views(1).truth.view_ids.shape == (1, 1, *PICTURE[2:])


def test_scenes_share_one_compiled_function(pictures):
    trace: Any = _trace.trace_view
    before = trace._cache_size()
    world = synthetic.make_world(
        [synthetic.plane((0.0, 0.0, 3.0), (9.0, 9.0), material=PLAIN)] * 5, shadow=0.3
    )
    scene = synthetic.make_scene(world, disparity_range=(0.0, 3.0), focal=1.1, focus=2.5)
    render(scene, shape=PICTURE, key=KEY)
    render(synthetic.scene("edges", key=jax.random.key(3)), shape=PICTURE, key=jax.random.key(9))
    assert trace._cache_size() == before


def test_keys_seed_noise_and_textures(pictures):
    scene, light_field = pictures["edges"]
    again = render(scene, shape=PICTURE, key=jax.random.key(5))
    np.testing.assert_array_equal(again.views, light_field.views)  # no noise to seed
    other = render(synthetic.scene("edges", key=jax.random.key(1)), shape=PICTURE, key=KEY)
    assert float(jnp.abs(other.views - light_field.views).mean()) > 0.02
    np.testing.assert_array_equal(other.truth.view_disparity, light_field.truth.view_disparity)


def _grey(**sensor):
    world = synthetic.make_world(
        [
            synthetic.plane((0.0, 0.0, 4.0), (99.0, 99.0), material=PLAIN),
            synthetic.plane(
                (2.0, 0.0, 3.9),
                (4.0, 99.0),
                material=DARK,
            ),
        ],
        shadow=0.0,
    )
    return synthetic.make_scene(world, disparity_range=(-1.0, 1.0), **sensor)


def test_sensor_noise_has_the_stated_variance_and_its_own_draw_per_view():
    shape = (1, 3, *SMALL[2:])
    clean = render(_grey(), shape=shape, samples=1, key=KEY).views
    scene = _grey(read_noise=0.02, shot_noise=0.001)
    noisy, same, other = (
        render(scene, shape=shape, samples=1, key=key).views
        for key in (KEY, KEY, jax.random.key(1))
    )
    np.testing.assert_array_equal(noisy, same)
    noise = np.asarray(noisy - clean)
    for level in np.unique(np.round(clean[0, 1, :, [5, 48]], 4)):
        where = np.abs(np.asarray(clean) - level) < 1e-3
        expected = np.sqrt(0.02**2 + 0.001 * level)
        assert abs(noise[where].std() / expected - 1) < 0.05
        assert abs(noise[where].mean()) < 0.001
    assert abs(np.corrcoef(noise[0, 0].ravel(), noise[0, 1].ravel())[0, 1]) < 0.05
    assert abs(np.corrcoef(noise.ravel(), np.asarray(other - clean).ravel())[0, 1]) < 0.05


def test_lenses_of_uneven_brightness_are_another_in_every_view():
    """Against the closed form: a paraboloid that is 1 at its own center."""
    shape = (1, 3, *SMALL[2:])
    clean = render(_grey(), shape=shape, samples=1, key=KEY).views
    scene = _grey().through_lenses(vignette=0.4, vignette_shift=0.05, gain=0.02)
    uneven, same, other = (
        render(scene, shape=shape, samples=1, key=key).views
        for key in (KEY, KEY, jax.random.key(1))
    )
    np.testing.assert_array_equal(uneven, same)
    assert float(jnp.abs(other - uneven).max()) > 0.01
    height, width = shape[2:]
    y, x = np.mgrid[:height, :width] - (np.array([height, width]) - 1)[:, None, None] / 2
    square = 4 * (x**2 + y**2) / ((height - 1) ** 2 + (width - 1) ** 2)
    basis = np.stack([np.ones_like(square), x, y, square], axis=-1).reshape(-1, 4)
    gains, centres = [], []
    for view in np.asarray(uneven / clean)[0]:
        fit, *_ = np.linalg.lstsq(basis, view[..., 0].ravel(), rcond=None)
        np.testing.assert_allclose(basis @ fit, view[..., 0].ravel(), atol=1e-5)
        gains.append(fit[0])
        assert fit[3] / fit[0] == pytest.approx(-0.4, rel=0.03)
        centres.append(fit[1:3] / fit[0])
    assert 0.002 < np.std(gains) < 0.08
    assert np.ptp(centres, axis=0).max() > 1e-3
    plain = _grey().through_lenses(vignette=0.0, gain=0.0)
    np.testing.assert_array_equal(render(plain, shape=shape, samples=1, key=KEY).views, clean)
    with pytest.raises(ValueError, match="`vignette` must be between 0 and 1, got 1.5"):
        _grey().through_lenses(vignette=1.5)


def test_blur_has_the_stated_width():
    def linear(image):
        image = np.asarray(image, float)
        return np.where(image <= 0.04045, image / 12.92, ((image + 0.055) / 1.055) ** 2.4)

    shape = (1, 1, *SMALL[2:])
    sharp = linear(render(_grey(), shape=shape, samples=1, key=KEY).centre_view)
    soft = linear(render(_grey(blur=1.7), shape=shape, samples=1, key=KEY).centre_view)

    def width(image):
        edge = -np.diff(image[16, 15:39, 1])
        weight, x = edge / edge.sum(), np.arange(len(edge))
        mean = weight @ x
        return weight @ (x - mean) ** 2

    np.testing.assert_allclose(width(soft) - width(sharp), 1.7**2, rtol=0.02)
    np.testing.assert_allclose(soft.mean(), sharp.mean(), rtol=1e-3)


def test_edges_are_antialiased():
    """A pixel on an edge is the mix of what its samples see, spread like a tent."""
    width = PICTURE[3]
    edge = 2.0 + 0.3 * 4 / (FOCAL * width)  # 0.3 px right of the middle, at depth 4
    world = synthetic.make_world(
        [
            synthetic.plane((0.0, 0.0, 4.0001), (99.0, 99.0), material=PLAIN),
            synthetic.plane((edge, 0.0, 4.0), (4.0, 99.0), material=BLACK),
        ],
        shadow=0.0,
    )
    scene = synthetic.make_scene(world, disparity_range=(-1.0, 1.0))
    image = render(scene, shape=(1, 1, *PICTURE[2:]), key=KEY).centre_view
    row = np.asarray(image, float)[7, :, 1]
    row = np.where(row <= 0.04045, row / 12.92, ((row + 0.055) / 1.055) ** 2.4)
    position = (width - 1) / 2 + 0.3 - np.arange(width)  # of the edge, from the pixel's centre
    expected = (position[:, None] > _trace.tent(3)).mean(-1)
    np.testing.assert_allclose(row / row[0], expected, atol=1e-4)
    assert len(np.unique(expected)) > 2
    quantiles = np.sort(_trace.tent(64))
    cumulative = np.where(quantiles < 0, (1 + quantiles) ** 2 / 2, 1 - (1 - quantiles) ** 2 / 2)
    np.testing.assert_allclose(cumulative, (np.arange(64) + 0.5) / 64, atol=1e-9)


def test_shadows_darken_and_are_optional():
    solids = [
        synthetic.plane((0.0, 0.0, 6.0), (99.0, 99.0), material=PLAIN),
        synthetic.sphere((0.0, 0.0, 4.5), 0.4, material=PLAIN),
    ]
    lamp = (-0.3, -0.3, -0.9)
    _, with_shadow = exact(*solids, lamp=lamp, shadow=1.0)
    _, without = exact(*solids, lamp=lamp, shadow=0.0)
    difference = np.asarray(without.centre_view - with_shadow.centre_view)[..., 1]
    wall = np.asarray(without.truth.object_ids) == 1
    assert difference.min() >= -1e-9
    # The shadow of the ball, from the closed form of a parallel projection along the lamp.
    _, direction = rays(SMALL, 1, 2)
    offset = direction * 6.0 - np.array([0.0, 0.0, 4.5])
    towards = np.array(lamp) / np.linalg.norm(lamp)
    distance = np.linalg.norm(np.cross(offset, towards), axis=-1)
    np.testing.assert_array_equal((difference > 0.05)[wall & (distance < 0.35)], True)
    np.testing.assert_allclose(difference[wall & (distance > 0.5)], 0.0, atol=1e-9)
    assert (wall & (distance < 0.35)).sum() > 10


def test_only_specular_surfaces_change_with_the_view():
    def error(**changes):
        material = replace(PLAIN, **changes)
        wall = synthetic.plane((0.0, 0.0, 6.0), (99.0, 99.0), material=PLAIN)
        ball = synthetic.sphere((0.0, 0.0, 3.6), 0.9, material=material)
        world = synthetic.make_world([wall, ball])
        scene = synthetic.make_scene(world, disparity_range=(-5.0, 5.0))
        light_field = render(scene, shape=PICTURE, key=KEY)
        views = np.asarray(light_field.views, float) * 255
        warped = _warp(light_field, (1, 0), (1, 2), views[1, 2], 3)
        seen = synthetic.visibility(scene, shape=PICTURE, source=(1, 0), target=(1, 2))
        ball = np.asarray(seen) & (np.asarray(light_field.truth.view_ids[1, 0]) == 2)
        return np.percentile(np.abs(warped - views[1, 0])[ball], 97)

    assert error() < 1.0
    assert error(specular=0.9, mirror=0.3) > 5.0


def test_posed_views_agree_with_the_light_field(pictures):
    scene, light_field = pictures["demo"]
    height, width = PICTURE[2:]
    focal = float(light_field.camera.focal_px)
    intrinsics = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
    turn = np.eye(4)
    turn[:3, :3] = np.array(synthetic.rotation(yaw=-12.0, pitch=4.0, roll=3.0)).T
    turn[:3, 3] = [0.5, -0.1, 0.3]
    views = render_posed(
        scene, np.stack([np.eye(4), turn]), intrinsics, size=(height, width), key=KEY
    )
    np.testing.assert_allclose(views.images[0], light_field.centre_view, atol=2e-3)
    np.testing.assert_array_equal(views.object_ids[0], light_field.truth.object_ids)
    np.testing.assert_allclose(
        views.depth[0], light_field.camera.depth(light_field.truth.disparity), rtol=1e-5
    )
    # Points of the turned photograph, in the first: the same solid at the same depth, or hidden.
    pose = np.asarray(views.poses[1], float)
    y, x = np.mgrid[:height, :width]
    ray = np.linalg.inv(intrinsics) @ np.stack([x, y, np.ones_like(x)]).reshape(3, -1)
    point = pose[:3, :3] @ (ray * np.asarray(views.depth[1]).ravel()) + pose[:3, 3:]
    image = intrinsics @ point
    xi, yi = np.round(image[:2] / image[2]).astype(int)
    inside = (xi >= 0) & (xi < width) & (yi >= 0) & (yi < height)
    there = np.asarray(views.depth[0])[yi[inside], xi[inside]]
    own = point[2][inside]
    same = (
        np.asarray(views.object_ids[0])[yi[inside], xi[inside]]
        == np.asarray(views.object_ids[1]).ravel()[inside]
    )
    assert inside.mean() > 0.4
    assert same.mean() > 0.7
    assert (np.abs(there / own - 1)[same] < 0.02).mean() > 0.97
    assert (there < own * 1.02)[~same].mean() > 0.8


def test_progress_counts_views():
    seen = []
    render(
        synthetic.scene("crossing"),
        shape=(3, 1, *SMALL[2:]),
        samples=1,
        progress=lambda done, total: seen.append((done, total)),
        key=KEY,
    )
    assert seen == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: synthetic.scene("nosuch"), "`name` must be one of demo, .*got 'nosuch'"),
        (
            lambda s: render(s, shape=(4, 3, 8, 8), key=KEY),
            "odd numbers of view rows and columns, got 4x3",
        ),
        (lambda s: render(s, shape=(3, 3, 0, 8), key=KEY), "positive integers"),
        (
            lambda s: render(s, shape=(1, 1, 8, 8), samples=0, key=KEY),
            "`samples` must be between 1 and 16 .*got 0",
        ),
        (
            lambda s: synthetic.visibility(s, shape=(1, 3, 8, 8), source=(0, 1), target=(1, 1)),
            r"`target` must be a view of the 1x3 grid, got \(1, 1\)",
        ),
        (
            lambda s: render_posed(s, np.eye(4)[None] * 2, np.eye(3), size=(8, 8), key=KEY),
            "`poses` must be rigid",
        ),
        (
            lambda s: render_posed(s, np.eye(4)[None], np.ones((2, 3, 3)), size=(8, 8), key=KEY),
            r"`intrinsics` must have the shape \[3, 3\] or \[1, 3, 3\], got \(2, 3, 3\)",
        ),
        (lambda s: synthetic.make_world([]), "`solids` must have at least one"),
        (
            lambda s: synthetic.make_scene(s.world, disparity_range=(1.0, 1.0)),
            "`disparity_range` must be",
        ),
        (
            lambda s: synthetic.make_scene(s.world, disparity_range=(0.0, 1.0), blur=4.0),
            "`blur` must be between 0 and 3 px, got 4.0",
        ),
        (
            lambda s: synthetic.bar((0.0, 0.0, 1.0), (0.0, 0.0, 1.0), 0.1),
            "`start` and `stop` must differ",
        ),
    ],
)
def test_mistakes_are_explained(call, message):
    with pytest.raises(ValueError, match=message):
        call(synthetic.scene("crossing"))


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in synthetic.scene_names() if n != "noisy"])
def test_any_view_warps_to_any_other_at_full_size(name):
    scene = synthetic.scene(name)
    light_field = render(scene, shape=(3, 3, 512, 512), key=KEY)
    for source, target in [((1, 1), (0, 2)), ((0, 0), (2, 2)), ((2, 1), (0, 0))]:
        right, _ = photo_error(scene, light_field, source, target)
        assert np.median(right) < 0.5


@pytest.mark.slow
def test_a_full_light_field_in_a_minute():
    """Must show 3: 9x9 views of 512x512 in under 60 s on two cores, memory bounded."""
    scene = synthetic.scene("demo")
    start = time.perf_counter()
    light_field = render(scene, shape=(9, 9, 512, 512), key=KEY)
    light_field.views.block_until_ready()
    assert time.perf_counter() - start < 60
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20 < 3
    right, _ = photo_error(scene, light_field, (0, 0), (8, 8))
    assert np.median(right) < 0.5
