"""Where photographs show a pixel: against matrices, brute force, and a grid of views."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_modes
from numpy.testing import assert_allclose, assert_array_equal
from posed.walls import MATRIX, POSES, SIZE, places, turned, wall

from mvedge_jax.photometry.measuring import AdaptedMeasurement, ViewSplines
from mvedge_jax.photometry.views import GridShift, Parallax, PlaneParallax, ViewSet
from mvedge_jax.posed import projections

MATRICES = jnp.broadcast_to(jnp.asarray(MATRIX), (len(POSES), 3, 3))
IMAGES, DEPTHS = wall(POSES)


def of_pose(pose, scale=2.0):
    both = projections(
        jnp.stack([jnp.eye(4), jnp.asarray(pose)]), MATRICES[:2], 0, jnp.asarray(scale)
    )
    return PlaneParallax(both.homography[1], both.epipole[1])


def within(x, y):
    return (x >= 0) & (x <= SIZE[1] - 1) & (y >= 0) & (y <= SIZE[0] - 1)


def test_positions_are_those_of_the_points():
    points = places(POSES[0], DEPTHS[0])
    for pose in SEEN[1:]:
        local = (points - pose[:3, 3]) @ pose[:3, :3] @ MATRIX.T
        found = of_pose(pose).positions(jnp.asarray(2.0 / DEPTHS[0]))
        for one, axis in zip(found, (0, 1), strict=True):
            assert_allclose(one, local[..., axis] / local[..., 2], atol=1e-9)


def test_far_never_occludes_near():
    """Cameras that face each other: to the other one, the card at depth 3 is before that at 1."""
    place = of_pose(turned(yaw=180.0, at=(0.0, 0.0, 4.0)))
    disparity = 2.0 / jnp.where(X < 24, 1.0, 3.0)
    u, v = (np.asarray(p) for p in place.positions(disparity))
    seen = np.asarray(place.seen(disparity, 1))
    # In the other camera the card at 3 is at depth 1, that at 1 at depth 3, and where both land...
    far, near = X < 24, X >= 24
    both = far & np.isin(np.round(u), np.round(u[near & seen]))
    # ... the one that is near to that camera is never hidden by the other.
    assert seen[near & within(u, v)].all()
    assert not seen[both & within(u, v)].any()


def test_behind_the_camera_is_masked_and_never_nan():
    """A camera in the middle of the scene, half of which is behind it."""
    place, disparity = of_pose(turned(at=(0.1, 0.0, 1.5))), 2.0 / jnp.where(X < 24, 1.0, 3.0)
    assert not np.asarray(place.seen(disparity, 1))[X < 24].any()
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
    """Of a pixel of a plane, whose positions and its neighbors' are known without derivatives."""
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
