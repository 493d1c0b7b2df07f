"""Where photographs show a pixel: against matrices, brute force, and a grid of views."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_modes, with_values
from photometry.planes import plane_views
from posed.walls import MATRIX, POSES, SIZE, places, turned, wall

from mvedge_jax.photometry.measuring import Measuring, ViewSplines, labels
from mvedge_jax.photometry.views import GridShift, PlaneParallax, ViewSet, views_of
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


def test_positions_are_those_of_the_points():
    points = places(POSES[0], DEPTHS[0])
    for pose in POSES[1:]:
        local = (points - pose[:3, 3]) @ pose[:3, :3] @ MATRIX.T
        x, y = of_pose(pose).positions(jnp.asarray(2.0 / DEPTHS[0]))
        np.testing.assert_allclose(x, local[..., 0] / local[..., 2], atol=1e-9)
        np.testing.assert_allclose(y, local[..., 1] / local[..., 2], atol=1e-9)


def test_steps_and_slopes_are_derivatives():
    place, disparity = of_pose(POSES[1]), jnp.asarray(2.0 / DEPTHS[0])
    _, moved = jax.jvp(place.positions, (disparity,), (jnp.ones_like(disparity),))
    steps = place.steps(disparity)
    # Moving the pixel by the steps moves it in the view as a change of disparity does.
    still = jnp.full(SIZE, 1.1)
    x, y = (np.asarray(p) for p in place.positions(still))
    (xx, yx), (xy, yy) = ([np.gradient(p, axis=axis)[5, 7] for p in (x, y)] for axis in (1, 0))
    sx, sy = (np.asarray(s)[5, 7] for s in place.steps(still))
    _, wanted = jax.jvp(place.positions, (still,), (jnp.ones_like(still),))
    np.testing.assert_allclose(xx * sx + xy * sy, wanted[0][5, 7], rtol=1e-4)
    np.testing.assert_allclose(yx * sx + yy * sy, wanted[1][5, 7], rtol=1e-4)
    # So a slope of the view along its movement is the pulled slope along the steps.
    slopes = jnp.ones((1, *SIZE)), jnp.full((1, *SIZE), -0.5)
    pulled = place.pulled(disparity, slopes)
    np.testing.assert_allclose(
        pulled[0][0] * steps[0] + pulled[1][0] * steps[1], moved[0] - 0.5 * moved[1], rtol=1e-9
    )


def test_a_grid_of_views_is_a_case_of_photographs():
    field = plane_views(0.3, views=(3, 3), size=(14, 17))
    views, start = views_of(field), jnp.full((14, 17), 0.27)
    assert isinstance(views.parallax, GridShift)
    posed = views._replace(parallax=projected(views.parallax))
    found = [ViewSplines.of(of).look(start, Measuring(radius=2)) for of in (views, posed)]
    for shift, plane in zip(*(jax.tree.leaves(f) for f in found), strict=True):
        np.testing.assert_allclose(plane, shift, atol=1e-12)


def test_measures_a_slanted_wall():
    scale = 2.0
    place = projections(jnp.asarray(POSES), MATRICES, 0, jnp.asarray(scale))
    views = ViewSet(jnp.moveaxis(jnp.asarray(IMAGES), -1, 1), place, jnp.ones(4, bool))
    truth = scale / jnp.asarray(DEPTHS[0])
    lab = jnp.zeros((3, *SIZE))
    params = with_values(Measuring, noise=0.5 / 255)
    for wrong in (0.05, -0.08):
        start = truth + wrong
        found = ViewSplines.of(views).look(start, params)
        found = labels(found, lab, start, params, passes=1)
        error = np.abs(np.asarray(found.disparity - truth))[3:-3, 3:-3]
        assert np.median(error) < 0.12 * abs(wrong)


def visible(pose, front, back, edge):
    """A card in front of a wall: which pixels of the wall the other camera sees, ray by ray."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    ray = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(MATRIX).T
    on_card = x < edge
    points = ray * np.where(on_card, front, back)[..., None]
    limit = (edge - 0.5 - MATRIX[0, 2]) / MATRIX[0, 0] * front
    away = pose[:3, 3] - points
    # Where the line of sight crosses the plane of the card.
    share = np.clip((front - points[..., 2]) / away[..., 2], 0, None)
    cross = points + share[..., None] * away
    blocked = ~on_card & (share < 1) & (cross[..., 0] < limit)
    local = (points - pose[:3, 3]) @ pose[:3, :3] @ MATRIX.T
    u, v = local[..., 0] / local[..., 2], local[..., 1] / local[..., 2]
    inside = (u >= 0) & (u <= SIZE[1] - 1) & (v >= 0) & (v <= SIZE[0] - 1) & (local[..., 2] > 0)
    return inside & ~blocked, inside, on_card


@pytest.mark.parametrize(
    "pose",
    [
        turned(at=(0.25, 0.02, -0.01)),
        turned(at=(-0.2, 0.03, 0.02), yaw=-3.0),
        turned(at=(0.2, -0.1, 0.05), roll=25.0),
    ],
)
def test_near_things_hide_far_ones(pose):
    front, back, edge = 1.2, 2.5, 20
    seen, inside, on_card = visible(pose, front, back, edge)
    disparity = 8.0 / jnp.where(jnp.asarray(on_card), front, back)
    found = np.asarray(of_pose(pose, 8.0).seen(disparity, 1))
    wrong = found != seen
    # Half a pixel of doubt about the outline.
    assert wrong.sum() < 0.5 * SIZE[0] + 0.02 * wrong.size
    hidden = inside & ~seen
    if hidden.any():
        assert (~found)[hidden].mean() > 0.85


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
    inside = (u >= 0) & (u <= SIZE[1] - 1) & (v >= 0) & (v <= SIZE[0] - 1)
    assert seen[near & inside].all()
    assert not seen[both & inside].any()


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
        found = ViewSplines.of(views).look(disparity, Measuring())
        return sum(jnp.sum(leaf) for leaf in jax.tree.leaves(found))

    value, gradients = jax.value_and_grad(total, argnums=(0, 1))(disparity, both)
    assert bool(jnp.isfinite(value))
    for leaf in jax.tree.leaves(gradients):
        assert bool(jnp.isfinite(leaf).all())


def test_gradients_of_a_measurement_in_photographs():
    """With respect to images, poses and the map."""
    lab = jnp.zeros((3, *SIZE))
    start = 2.0 / jnp.asarray(DEPTHS[0]) + 0.03

    def total(tree):
        images, poses, disparity = tree
        place = projections(poses, MATRICES[:3], 0, jnp.asarray(2.0))
        views = ViewSet(jnp.moveaxis(images, -1, 1), place, jnp.ones(3, bool))
        found = ViewSplines.of(views).look(disparity, Measuring())
        found = labels(found, lab, disparity, Measuring(), passes=1)
        return jnp.mean(found.disparity**2) + jnp.mean(jnp.log(found.variance))

    tree = (jnp.asarray(IMAGES[:3]), jnp.asarray(POSES[:3]), start)
    check_modes(total, tree, rtol=2e-4, step=1e-7, key=jax.random.key(0))


def test_a_shift_needs_no_turning():
    place = GridShift(jnp.asarray([2.0, -1.0]))
    slopes = jnp.ones((3, *SIZE)), jnp.zeros((3, *SIZE))
    assert place.pulled(jnp.zeros(SIZE), slopes) is slopes
