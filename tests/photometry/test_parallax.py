"""Where photographs show a pixel: against matrices, brute force, and a grid of views."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_modes, with_values
from numpy.testing import assert_allclose, assert_array_equal
from posed.walls import MATRIX, POSES, SIZE, places, turned, wall

from mvedge_jax.photometry.measuring import AdaptedMeasurement, ViewSplines, labels
from mvedge_jax.photometry.views import GridShift, Parallax, PlaneParallax, ViewSet
from mvedge_jax.posed import projections

MATRICES = jnp.broadcast_to(jnp.asarray(MATRIX), (len(POSES), 3, 3))
IMAGES, DEPTHS = wall(POSES)


def of_pose(pose, scale=2.0):
    both = projections(
        jnp.stack([jnp.eye(4), jnp.asarray(pose)]), MATRICES[:2], 0, jnp.asarray(scale)
    )
    return PlaneParallax(both.homography[1], both.epipole[1])


def projected(shift):
    """The same as a homography and an epipole."""
    step = shift.step
    eye = jnp.broadcast_to(jnp.eye(3, dtype=step.dtype), (*step.shape[:-1], 3, 3))
    return PlaneParallax(eye, jnp.concatenate([step, jnp.zeros_like(step[..., :1])], axis=-1))


def within(x, y):
    return (x >= 0) & (x <= SIZE[1] - 1) & (y >= 0) & (y <= SIZE[0] - 1)


def test_positions_are_those_of_the_points():
    points = places(POSES[0], DEPTHS[0])
    for pose in SEEN[1:]:
        local = (points - pose[:3, 3]) @ pose[:3, :3] @ MATRIX.T
        found = of_pose(pose).positions(jnp.asarray(2.0 / DEPTHS[0]))
        for one, axis in zip(found, (0, 1), strict=True):
            assert_allclose(one, local[..., axis] / local[..., 2], atol=1e-9)


def test_measures_a_slanted_wall():
    scale = 2.0
    place = projections(jnp.asarray(POSES), MATRICES, 0, jnp.asarray(scale))
    views = ViewSet(jnp.moveaxis(jnp.asarray(IMAGES), -1, 1), place, jnp.ones(4, bool))
    truth = scale / jnp.asarray(DEPTHS[0])
    lab = jnp.zeros((3, *SIZE))
    params = with_values(AdaptedMeasurement, noise=0.5 / 255)
    for wrong in (0.05, -0.08):
        start = truth + wrong
        found = ViewSplines.of(views).accumulate(start, params)
        found = labels(found, lab, start, params, passes=1)
        error = np.abs(np.asarray(found.disparity - truth))[3:-3, 3:-3]
        assert np.median(error) < 0.12 * abs(wrong)


def test_far_never_occludes_near():
    """Crossing cameras: seen from the far side, what is far from the reference is near.

    Two cards at depths 1 and 3, cameras that face each other: the other camera, behind both and
    turned around, has the card at 3 before that at 1, though its disparity is smaller.
    """
    pose = turned(yaw=180.0, at=(0.0, 0.0, 4.0))
    place = of_pose(pose)
    x = np.arange(SIZE[1])[None] + 0 * np.arange(SIZE[0])[:, None]
    disparity = 2.0 / jnp.where(jnp.asarray(x < 24), 1.0, 3.0)
    u, v = (np.asarray(p) for p in place.positions(disparity))
    seen = np.asarray(place.seen(disparity, 1))
    # In the other camera the card at 3 is at depth 1, that at 1 at depth 3, and where both land...
    far, near = x < 24, x >= 24
    both = far & np.isin(np.round(u), np.round(u[near & seen]))
    # ... the one that is near to that camera is never hidden by the other.
    assert seen[near & within(u, v)].all()
    assert not seen[both & within(u, v)].any()


def test_behind_the_camera_is_masked_and_never_nan():
    """A camera in the middle of the scene, half of which is behind it."""
    pose = turned(at=(0.1, 0.0, 1.5))
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    depth = jnp.where(jnp.asarray(x < 24), 1.0, 3.0)
    place, disparity = of_pose(pose), 2.0 / depth
    assert not np.asarray(place.seen(disparity, 1))[x < 24].any()
    for values in (place.positions(disparity), place.steps(disparity)):
        assert all(bool(jnp.isfinite(v).all()) for v in values)
    both = PlaneParallax(
        jnp.stack([jnp.eye(3), place.homography]), jnp.stack([jnp.zeros(3), place.epipole])
    )
    images = jnp.moveaxis(jnp.asarray(IMAGES[:2]), -1, 1)

    def total(disparity, parallax):
        views = ViewSet(images, parallax, jnp.ones(2, bool))
        found = ViewSplines.of(views).accumulate(disparity, AdaptedMeasurement())
        return sum(jnp.sum(leaf) for leaf in jax.tree.leaves(found))

    value, gradients = jax.value_and_grad(total, argnums=(0, 1))(disparity, both)
    assert bool(jnp.isfinite(value))
    for leaf in jax.tree.leaves(gradients):
        assert bool(jnp.isfinite(leaf).all())


@pytest.mark.slow
def test_gradients_of_a_measurement_in_photographs():
    """With respect to images, poses and the map."""
    lab = jnp.zeros((3, *SIZE))
    start = 2.0 / jnp.asarray(DEPTHS[0]) + 0.03

    def total(tree):
        images, poses, disparity = tree
        place = projections(poses, MATRICES[:3], 0, jnp.asarray(2.0))
        views = ViewSet(jnp.moveaxis(images, -1, 1), place, jnp.ones(3, bool))
        found = ViewSplines.of(views).accumulate(disparity, AdaptedMeasurement())
        found = labels(found, lab, disparity, AdaptedMeasurement(), passes=1)
        return jnp.mean(found.disparity**2) + jnp.mean(jnp.log(found.variance))

    tree = (jnp.asarray(IMAGES[:3]), jnp.asarray(POSES[:3]), start)
    check_modes(total, tree, rtol=2e-4, step=1e-7, key=jax.random.key(0))


# What every `Parallax` has to keep: a new one is added here.
SEEN = np.stack([*POSES[:3], turned(at=(0.2, -0.1, 0.05), roll=25.0)])
STEPS = np.array([[0.0, 0.0], [1.0, 0.0], [-2.0, 1.0], [0.5, -1.5]])
STACKS = {
    "shift": GridShift(jnp.asarray(STEPS)),
    "plane": projections(jnp.asarray(SEEN), MATRICES, 0, jnp.asarray(4.0)),
}
Y, X = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
BOWL = jnp.asarray(1.2 + 0.3 * np.sin(0.2 * X) * np.cos(0.15 * Y))
CARD = jnp.asarray(np.where((np.abs(X - 22) < 7) & (np.abs(Y - 16) < 6), 3.0, 1.0))


def one_of(stack, index):
    return jax.tree.map(lambda leaf: leaf[index], stack)


@pytest.fixture(params=STACKS)
def stack(request):
    return STACKS[request.param]


def test_the_reference_shows_every_pixel_at_its_own_place(stack):
    assert isinstance(stack, Parallax)
    own = one_of(stack, 0)
    assert float(own.apart) == 0
    assert float(stack.apart[1:].min()) > 0
    assert_array_equal(own.positions(BOWL), np.broadcast_arrays(X, Y))
    assert bool(own.seen(CARD, 9).all())


def test_steps_and_pulled_slopes_are_those_of_differences(stack):
    """Of a pixel of a plane, whose positions and its neighbours' are known without derivatives."""
    flat, tiny, slopes = jnp.full(SIZE, 1.1), 1e-5, (0.7, -0.4)
    inner = (slice(1, -1), slice(1, -1))
    for index in range(1, 4):
        place = one_of(stack, index)
        x, y = (np.broadcast_to(p, SIZE) for p in place.positions(flat))
        (xx, yx), (xy, yy) = ([np.gradient(p, axis=axis) for p in (x, y)] for axis in (1, 0))
        after, before = (place.positions(flat + t) for t in (tiny, -tiny))
        moved = [np.asarray(a - b) / (2 * tiny) for a, b in zip(after, before, strict=True)]
        sx, sy = place.steps(flat)
        for found, wanted in ((xx * sx + xy * sy, moved[0]), (yx * sx + yy * sy, moved[1])):
            assert_allclose(found[inner], wanted[inner], rtol=2e-3, atol=1e-6)
        along = place.pulled(flat, tuple(jnp.full((1, *SIZE), s) for s in slopes))
        for found, (dx, dy) in zip(along, ((xx, yx), (xy, yy)), strict=True):
            wanted = slopes[0] * dx + slopes[1] * dy
            assert_allclose(found[0][inner], wanted[inner], rtol=2e-3, atol=1e-6)


def test_seen_is_what_no_nearer_pixel_lands_on(stack):
    """By brute force: of all pixels that land within half a pixel, the nearest is seen."""
    near = np.asarray(CARD).ravel()
    for index in range(1, 4):
        place = one_of(stack, index)
        x, y = (np.broadcast_to(p, SIZE).ravel() for p in place.positions(CARD))
        inside = within(x, y)
        over = (np.abs(x[:, None] - x) <= 0.5) & (np.abs(y[:, None] - y) <= 0.5)
        hidden = (over & (near[None] > near[:, None] + 0.5)).any(1)
        found = np.asarray(place.seen(CARD, 12)).ravel()
        # Half a pixel of doubt about the outline.
        assert (found != (inside & ~hidden)).mean() < 0.04
        assert (~found[inside & hidden]).mean() > 0.8
        assert not found[~inside].any()


def test_positions_have_derivatives_in_both_modes_and_programs_agree(stack):
    place, slopes = one_of(stack, 2), (jnp.ones((1, *SIZE)), jnp.full((1, *SIZE), -0.5))

    def values(tree):
        place, disparity = tree
        steps = (jnp.broadcast_to(s, SIZE) for s in place.steps(disparity))
        return (*place.positions(disparity), *steps, *place.pulled(disparity, slopes))

    def loss(tree):
        return sum((jnp.sum(jnp.sin(0.1 * value)) for value in values(tree)), jnp.zeros(()))

    check_modes(loss, (place, BOWL), rtol=1e-6, key=jax.random.key(0))
    for eager, compiled in zip(values((place, BOWL)), jax.jit(values)((place, BOWL)), strict=True):
        assert_allclose(compiled, eager, rtol=1e-12, atol=1e-12)


def test_a_stack_is_a_loop(stack):
    def of(place):
        return (*place.positions(CARD), place.seen(CARD, 9))

    found = jax.vmap(of)(stack)
    for index in range(4):
        for batched, alone in zip(found, of(one_of(stack, index)), strict=True):
            assert_allclose(batched[index], alone, rtol=1e-12, atol=1e-12)


def test_a_shift_is_a_case_of_a_plane_and_its_epipole():
    shifts = STACKS["shift"]
    planes = projected(shifts)
    assert_allclose(planes.apart, shifts.apart)
    for index in range(4):
        shift, plane = one_of(shifts, index), one_of(planes, index)
        for name in ("positions", "steps"):
            pair = zip(getattr(shift, name)(BOWL), getattr(plane, name)(BOWL), strict=True)
            for one, other in pair:
                assert_allclose(np.asarray(one) - np.asarray(other), 0, atol=1e-12)
        slopes = jnp.ones((3, *SIZE)), jnp.zeros((3, *SIZE))
        assert shift.pulled(BOWL, slopes) is slopes
        for one, other in zip(slopes, plane.pulled(BOWL, slopes), strict=True):
            assert_allclose(other, one, atol=1e-12)
        # One looks along its step, the other draws all pixels: outlines differ by half a pixel.
        assert float(jnp.mean(shift.seen(CARD, 9) != plane.seen(CARD, 9))) < 0.04
