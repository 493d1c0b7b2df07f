"""The renderer against closed forms: disparity, ids, occlusion, photo-consistency, mistakes."""

import inspect
import resource
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import map_coordinates, maximum_filter, minimum_filter

from experiments.peers import photographs
from mvedge_jax.datasets import synthetic

pytestmark = pytest.mark.usefixtures("optimized")
KEY = jax.random.key(0)
# Few sizes, so that few functions are compiled.
SMALL = (3, 5, 60, 54)  # one ray per pixel
PICTURE = (3, 3, 150, 176)  # nine rays per pixel
FOCAL, GAIN, FOCUS = 1.4, 20.0, 4.0


def render(scene, shape=SMALL, *, samples=1, key=KEY, progress=None) -> Any:  # the truth is there
    return synthetic.render(scene, shape=shape, samples=samples, progress=progress, key=key)


def exact(*solids):
    """The light field of a float64 scene."""
    world = synthetic.make_world(list(solids), dtype=jnp.float64)
    return render(synthetic.make_scene(world, disparity_range=(-5.0, 5.0)))


def rays(shape, v, u):
    """Origin and directions (z = 1) of a view of the default rig, from the documentation alone."""
    rows, columns, height, width = shape
    focal = FOCAL * max(height, width)
    y, x = np.mgrid[:height, :width].astype(float)
    du, dv = u - columns // 2, v - rows // 2
    across = (x - (width - 1) / 2 - du * GAIN / FOCUS) / focal
    down = (y - (height - 1) / 2 - dv * GAIN / FOCUS) / focal
    return np.array([du, dv, 0.0]) * GAIN / focal, np.stack([across, down, 1 + 0 * x], axis=-1)


@pytest.fixture(scope="module")
def pictures():
    """Every named scene without noise, small."""
    scenes = {name: synthetic.scene(name) for name in synthetic.scene_names() if name != "noisy"}
    return {name: (scene, render(scene, PICTURE, samples=3)) for name, scene in scenes.items()}


def test_disparities_and_ids_of_planes_spheres_and_sky_are_exact_in_every_view():
    turned = synthetic.rotation(yaw=35.0, pitch=-20.0, roll=10.0)
    axes = np.array(turned)
    corner, half = np.array([0.2, -0.1, 6.5]), np.array([1.4, 1.1])
    ball, radius = np.array([0.1, 0.05, 3.6]), 0.8
    wall = synthetic.plane(tuple(corner), tuple(2 * half), axes=turned)
    field = exact(wall, synthetic.sphere(tuple(ball), radius))
    truth = field.truth
    for v, u in np.ndindex(SMALL[:2]):
        origin, ray = rays(SMALL, v, u)
        on_wall = axes[2] @ (corner - origin) / (ray @ axes[2])
        place = (origin + ray * on_wall[..., None] - corner) @ axes[:2].T
        on_wall = np.where((np.abs(place) < half).all(-1), on_wall, np.inf)
        a, b = (ray * ray).sum(-1), ray @ (origin - ball)
        square = b * b - a * ((origin - ball) @ (origin - ball) - radius**2)
        on_ball = np.where(square > 0, (-b - np.sqrt(np.maximum(square, 0))) / a, np.inf)
        depth = np.minimum(on_ball, on_wall)
        ids = np.where(on_ball < on_wall, 2, np.where(np.isfinite(depth), 1, 0))
        assert_array_equal(truth.view_ids[v, u], ids)
        assert_allclose(truth.view_disparity[v, u], GAIN * (1 / depth - 1 / FOCUS), atol=1e-12)
        assert set(np.unique(ids)) == {0, 1, 2}
    sky = np.asarray(truth.object_ids) == 0
    assert np.isinf(np.asarray(field.camera.depth(truth.disparity))[sky]).all()


def test_points_on_boxes_and_bars_lie_on_their_surfaces():
    axes = synthetic.rotation(yaw=30.0, pitch=15.0, roll=5.0)
    start, stop, radius = np.array([-0.9, -0.3, 3.2]), np.array([0.7, 0.5, 3.9]), 0.12
    field = exact(
        synthetic.plane((0.0, 0.0, 9.0), (99.0, 99.0)),
        synthetic.box((0.5, -0.2, 5.0), (1.6, 1.4, 1.0), axes=axes),
        synthetic.bar(tuple(start), tuple(stop), radius),
    )
    for v, u in np.ndindex(SMALL[:2]):
        origin, direction = rays(SMALL, v, u)
        depth = np.asarray(field.camera.depth(field.truth.view_disparity[v, u]))
        point, ids = origin + direction * depth[..., None], np.asarray(field.truth.view_ids[v, u])
        local = np.abs((point[ids == 2] - [0.5, -0.2, 5.0]) @ np.array(axes).T)
        assert_allclose((local - [0.8, 0.7, 0.5]).max(-1), 0.0, atol=1e-12)
        along = stop - start
        t = np.clip((point[ids == 3] - start) @ along / (along @ along), 0, 1)
        distance = np.linalg.norm(point[ids == 3] - start - t[:, None] * along, axis=-1)
        assert_allclose(distance, radius, atol=1e-12)
        assert {1, 2, 3} == set(np.unique(ids))


def test_single_precision_is_close():
    double, single = (render(synthetic.scene("demo", dtype=d)) for d in (jnp.float64, jnp.float32))
    assert single.views.dtype == single.truth.view_disparity.dtype == jnp.float32
    same = np.asarray(single.truth.view_ids == double.truth.view_ids)
    assert same.mean() > 0.999
    apart = np.asarray(single.truth.view_disparity, float) - double.truth.view_disparity
    error = np.abs(apart)[same]
    assert error.max() < 1e-4
    assert np.median(error) < 2e-6


def moved(field, source, target):
    """Where the source's pixels are in the target."""
    d = np.asarray(field.truth.view_disparity[source], float)
    y, x = np.mgrid[: d.shape[0], : d.shape[1]].astype(float)
    return x + (source[1] - target[1]) * d, y + (source[0] - target[0]) * d


def warp(field, source, target, values):
    """What is at the source's pixels in the target; cubic interpolation."""
    x, y = moved(field, source, target)
    colors = [map_coordinates(values[..., c], [y, x], order=3, mode="nearest") for c in range(3)]
    return np.stack(colors, axis=-1)


def photo_error(scene, field, source, target):
    """Absolute errors of 255 over what both views see, and those of the wrong direction."""
    shape = field.views.shape[:4]
    seen = np.asarray(synthetic.visibility(scene, shape=shape, source=source, target=target))
    there, own = (np.asarray(field.views[k], float) * 255 for k in (target, source))
    pairs = (source, target), (target, source)
    return (np.abs(warp(field, one, other, there) - own)[seen] for one, other in pairs)


# The still life is all detail at this size; it is shown at 512 px below.
@pytest.mark.parametrize("name", [n for n in synthetic.scene_names() if n not in {"noisy", "demo"}])
def test_any_view_warps_to_any_other(pictures, name):
    """Must show 3: median error below 0.5/255 over unoccluded pixels."""
    for source, target in [((1, 1), (0, 2)), ((0, 0), (2, 2)), ((2, 1), (1, 1))]:
        scene, field = pictures[name]
        right, wrong = photo_error(scene, field, source, target)
        assert np.median(right) < 0.5
        if name != "textureless":
            assert wrong.mean() > 2 * right.mean()


def _peak_memory():
    """Of this process so far, GiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


@pytest.mark.slow
def test_a_full_light_field_in_bounded_memory():
    """9x9 views of 512x512; their time is measured by `experiments/benchmarks/first_line.py`."""
    scene, before = synthetic.scene("demo"), _peak_memory()
    field = render(scene, (9, 9, 512, 512), samples=3)
    field.views.block_until_ready()
    assert _peak_memory() <= max(3.0, before)  # that of an earlier test, if it took more
    for source, target in [((0, 0), (8, 8)), ((4, 4), (3, 5)), ((5, 4), (3, 3))]:
        right, _ = photo_error(scene, field, source, target)
        assert np.median(right) < 0.5


@pytest.mark.parametrize("name", ["edges", "wide", "demo"])
def test_visibility_agrees_with_the_truth_of_the_other_view(pictures, name):
    """Ids are consistent: seen is the same solid at the same disparity, hidden is behind another.

    Judged where the target's 3x3 pixels around the point all see one solid, which is proof but for
    what fits between pixels (a ridge of a box, the rim of a hole).
    """
    scene, field = pictures[name]
    hidden_pixels, (height, width) = 0, PICTURE[2:]
    for source, target in [((1, 1), (0, 2)), ((2, 2), (0, 0))]:
        seen, itself = (
            np.asarray(synthetic.visibility(scene, shape=PICTURE, source=source, target=t))
            for t in (target, source)
        )
        assert itself.all()
        (ids, own_ids), (d, own) = (
            (np.asarray(of[target]), np.asarray(of[source]))
            for of in (field.truth.view_ids, field.truth.view_disparity)
        )
        x, y = moved(field, source, target)
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


@pytest.mark.parametrize("name", synthetic.scene_names())
def test_named_scenes_keep_their_promises(name):
    """Truth within the range, several solids, a picture that is neither dark nor burnt out."""
    field = render(synthetic.scene(name))
    low, high = np.asarray(field.disparity_range)
    disparity = np.asarray(field.truth.view_disparity)
    # Not much room to spare either: a search over the range is not wasted.
    assert low <= disparity.min() < low + 0.5
    assert high - 0.5 < disparity.max() <= high
    assert len(np.unique(field.truth.object_ids)) >= 2
    assert 0.25 < float(field.views.mean()) < 0.75
    assert field.name == name
    if name == "wide":
        assert disparity.min() < -3.4
        assert disparity.max() > 3.4


def test_truth_is_the_same_at_any_resolution_and_number_of_samples():
    scene, seen = synthetic.scene("demo"), []
    # An even number of samples has none in the pixel's center: the truth takes one more ray.
    shape, large = (1, 3, 20, 18), render(scene, (1, 1, *SMALL[2:]))
    small = render(scene, shape, samples=2, progress=lambda *counts: seen.append(counts))
    assert seen == [(1, 3), (2, 3), (3, 3)]
    assert_array_equal(small.truth.object_ids, large.truth.object_ids[1::3, 1::3])
    assert_allclose(small.truth.disparity, large.truth.disparity[1::3, 1::3], atol=1e-4)


def test_keys_seed_noise_and_textures(pictures):
    scene, field = pictures["edges"]
    again = render(scene, PICTURE, samples=3, key=jax.random.key(5))
    assert_array_equal(again.views, field.views)  # no noise to seed
    other = render(synthetic.scene("edges", key=jax.random.key(1)), PICTURE, samples=3)
    assert float(jnp.abs(other.views - field.views).mean()) > 0.02
    assert_array_equal(other.truth.view_disparity, field.truth.view_disparity)


def test_posed_views_agree_with_the_light_field(pictures):
    scene, field = pictures["demo"]
    height, width = PICTURE[2:]
    focal = float(field.camera.focal_px)
    intrinsics = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
    poses = np.stack([np.eye(4)] * 2)
    poses[1, :3, :3] = np.array(synthetic.rotation(yaw=-12.0, pitch=4.0, roll=3.0)).T
    poses[1, :3, 3] = [0.5, -0.1, 0.3]
    views: Any = photographs.render_posed(scene, poses, intrinsics, size=(height, width), key=KEY)
    assert_allclose(views.images[0], field.center_view, atol=2e-3)
    assert_array_equal(views.object_ids[0], field.truth.object_ids)
    assert_allclose(views.depth[0], field.camera.depth(field.truth.disparity), rtol=1e-5)
    # Points of the turned photograph, in the first: the same solid at the same depth, or hidden.
    y, x = np.mgrid[:height, :width]
    ray = np.linalg.inv(intrinsics) @ np.stack([x, y, np.ones_like(x)]).reshape(3, -1)
    pose = np.asarray(views.poses[1], float)
    point = pose[:3, :3] @ (ray * np.asarray(views.depth[1]).ravel()) + pose[:3, 3:]
    image = intrinsics @ point
    xi, yi = np.round(image[:2] / image[2]).astype(int)
    inside = (xi >= 0) & (xi < width) & (yi >= 0) & (yi < height)
    there, own = np.asarray(views.depth[0])[yi[inside], xi[inside]], point[2][inside]
    ids = np.asarray(views.object_ids)
    same = ids[0][yi[inside], xi[inside]] == ids[1].ravel()[inside]
    assert inside.mean() > 0.4
    assert same.mean() > 0.7
    assert (np.abs(there / own - 1)[same] < 0.02).mean() > 0.97
    assert (there < own * 1.02)[~same].mean() > 0.8


def posed(scene, poses, matrices):
    return photographs.render_posed(scene, poses, matrices, size=(8, 8), key=KEY)


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda s: render(s, samples=0), "`samples` must be between 1 and 16 .*got 0"),
        (
            lambda s: synthetic.visibility(s, shape=(1, 3, 8, 8), source=(0, 1), target=(1, 1)),
            r"`target` must be a view of the 1x3 grid, got \(1, 1\)",
        ),
        (lambda s: posed(s, np.eye(4)[None] * 2, np.eye(3)), "`poses` must be rigid"),
        (
            lambda s: posed(s, np.eye(4)[None], np.ones((2, 3, 3))),
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
def test_mistakes_are_explained(call, match):
    with pytest.raises(ValueError, match=match):
        call(synthetic.scene("crossing"))


def test_camera_and_crop_agree_with_the_truth(pictures):
    _, field = pictures["demo"]
    truth = field.truth
    assert_allclose(field.camera.depth(truth.disparity)[0, 0], 1 / (0.25 - 1.35 / 20), rtol=1e-5)
    assert_array_equal(truth.disparity, truth.view_disparity[1, 1])
    assert_array_equal(truth.object_ids, truth.view_ids[1, 1])
    assert truth.valid.all()
    assert field.crop_views(1).truth.view_ids.shape == (1, 1, *PICTURE[2:])


@pytest.mark.parametrize("towards", [(0.0, 0.0), (1.0, -1.0), (0.25, 0.5)])
def test_a_part_of_a_scene_is_a_crop_of_a_larger_view(towards):
    near = 2.5  # the nearest surface is the one that a part is chosen by
    disparities = GAIN / 6.0 - GAIN / FOCUS, GAIN / near - GAIN / FOCUS
    card = synthetic.plane((0.1, 0.05, near), (1.2, 0.9))
    world = synthetic.make_world([card], dtype=jnp.float64)
    scene = synthetic.make_scene(world, disparity_range=disparities)
    large, part = render(scene, (1, 3, 64, 64)), render(scene.zoomed(2.0, towards), (1, 3, 32, 32))
    x, y = (round(16 + 16 * side) for side in towards)
    assert_allclose(part.views, large.views[:, :, y : y + 32, x : x + 32], atol=1e-9)
    assert_allclose(part.truth.disparity, large.truth.disparity[y : y + 32, x : x + 32], atol=1e-9)


def test_parts_of_scenes_are_checked():
    scene = synthetic.scene("edges")
    for factor, towards, name in ((0.5, (0.0, 0.0), "factor"), (2.0, (0.0, 1.1), "towards")):
        with pytest.raises(ValueError, match=f"`{name}` must be"):
            scene.zoomed(factor, towards)


def test_the_crosshair_alone_is_that_of_all_views():
    scene, shape = synthetic.scene("noisy"), (3, 5, 20, 18)
    whole = render(scene, shape)
    cross: Any = synthetic.render(scene, shape=shape, views="crosshair", samples=1, key=KEY)
    available = np.asarray(cross.available)
    assert available.sum() == 7
    assert_array_equal(np.asarray(cross.views)[available], np.asarray(whole.views)[available])
    assert not np.asarray(cross.views)[~available].any()
    assert cross.truth.view_disparity is None
    assert_array_equal(cross.truth.disparity, whole.truth.disparity)
    plain: Any = inspect.unwrap(synthetic.render)
    with pytest.raises(ValueError, match=r"`views` must be 'all' or 'crosshair', got 'row'"):
        plain(scene, shape=shape, views="row", key=KEY)
