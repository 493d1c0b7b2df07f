"""Transparent pixels of photographs: they take no part, and get no depth."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from posed.walls import MATRIX, POSES, places, room, turned, wall

from mvedge_jax.photometry import Noise
from mvedge_jax.photometry._scene import adapted_measurement
from mvedge_jax.photometry.measuring import Measurement, ViewSplines
from mvedge_jax.posed import Photographs, StereoDepth, posed_sweep, reference_of, stereo
from mvedge_jax.posed.scores import depth_errors

IMAGES, DEPTHS = wall(POSES)
Y, X = np.mgrid[:36, :48]
DISTANCE = np.hypot(X - 24, Y - 18)
MASK = np.stack([DISTANCE < 15] * 4)
RANGE = (1.2, 3.5)


def cut(color: float) -> Photographs:
    """The wall, of which a disc is left, on a color."""
    images = np.where(MASK[..., None], IMAGES, color)
    return Photographs(jnp.asarray(images), POSES, MATRIX, mask=MASK)


def test_what_is_transparent_is_read_in_no_photograph():
    """Of an opaque pixel, nothing changes with the color of what is transparent elsewhere."""
    params = adapted_measurement(Noise.of(jnp.asarray(0.002)), jnp.asarray(1.0), Measurement())
    # Splines reach far, though hardly: what is next to the mask is left out of it here.
    inner, both = DISTANCE < 5, []
    for view in (cut(0.0), cut(0.7)):
        wanted = reference_of(view, 0, depth_range=RANGE)
        shown = jnp.asarray(np.stack([inner] * 4), jnp.float64)
        views = eqx.tree_at(lambda v: v.shown, wanted.views(view), shown)
        disparity = wanted.scale(view) / jnp.asarray(DEPTHS[0])
        both.append(ViewSplines.of(views).accumulate(disparity, params))
    for name in ("right", "information", "power", "freedom"):
        one, other = (np.asarray(getattr(each, name)) for each in both)
        assert np.isfinite(one).all()
        np.testing.assert_allclose(one[inner], other[inner], atol=1e-3, rtol=0.02)
        # What is transparent is seen by the reference alone, and tells nothing.
        outer = one[~inner]
        assert (outer.max() if name == "freedom" else np.abs(outer).max()) < 1e-9


def test_a_sweep_has_no_depth_where_the_photograph_is_transparent():
    wanted = reference_of(cut(0.0), 0, depth_range=RANGE)
    model = StereoDepth.of(wanted)
    found, other = (np.asarray(posed_sweep(cut(c), wanted, model).depth) for c in (0.0, 0.7))
    assert np.isnan(found[~MASK[0]]).all()
    assert np.isfinite(found[MASK[0]]).all()
    # As far off as without a mask, .039.
    assert np.median(np.abs(found / DEPTHS[0] - 1)[DISTANCE < 9]) < 0.045
    # The color of what is transparent has no say.
    np.testing.assert_allclose(found[DISTANCE < 9], other[DISTANCE < 9], rtol=1e-6)


@pytest.mark.slow
def test_the_object_keeps_its_depth_and_the_rest_has_none():
    points = [places(*of) for of in zip(POSES, DEPTHS, strict=True)]
    middle, rim = points[0][18, 24], points[0][18, 39]
    away = np.linalg.norm(np.stack(points) - middle, axis=-1)
    disc = away < np.linalg.norm(rim - middle)

    def cut(color: float) -> Photographs:
        """A disc of the wall itself, so that every photograph shows all of the object."""
        images = np.where(disc[..., None], IMAGES, color)
        return Photographs(jnp.asarray(images), POSES, MATRIX, mask=disc)

    wanted = reference_of(cut(0.0), 0, depth_range=RANGE)
    run = jax.jit(lambda p: stereo(p, wanted, StereoDepth.of(wanted)))
    found = run(cut(0.0))
    depth, error = np.asarray(found.depth), np.asarray(found.error)
    assert np.isnan(depth[~disc[0]]).all()
    assert np.isinf(error[~disc[0]]).all()
    assert np.isfinite([depth[disc[0]], error[disc[0]]]).all()
    assert np.median(np.abs(depth / DEPTHS[0] - 1)[disc[0]]) < 0.01
    assert found.problems() == ()
    # The color of what is transparent has next to no say.
    other = np.asarray(run(cut(0.5)).depth)
    assert np.median(np.abs(other / DEPTHS[0] - 1)[DISTANCE < 11]) < 0.01


ROOM, CAMERA = (60, 80), np.array([[75.0, 0, 39.5], [0, 75.0, 29.5], [0, 0, 1]])


def around(x, y=0.0, z=0.0):
    """A camera that looks at the middle of the room from one side."""
    yaw, pitch = (np.rad2deg(np.arctan2(side, 2.0)) for side in (-x, y))
    return turned(yaw=yaw, pitch=pitch, at=(x, y, z))


PLACES = [(0,), (0.45, 0.05), (-0.4, -0.03), (0.75, -0.1, 0.1), (-0.7, 0.08)]
AROUND = np.stack([around(*place) for place in PLACES])


@pytest.mark.slow
def test_a_room_with_a_steep_floor_is_found_from_15_to_30_px_apart():
    images, depths = room(AROUND, matrix=CAMERA, size=ROOM)
    view = Photographs(jnp.asarray(images, jnp.float32), AROUND, CAMERA, depth=depths)
    farthest = np.linalg.norm(AROUND[:, :3, 3], axis=1)[1:]
    assert view.depth is not None
    moved = CAMERA[0, 0] * farthest / np.median(view.depth[0])
    assert (moved > 12).all()
    assert (moved < 30).all()
    wanted = reference_of(view, 0, depth_range=(0.9, 4.0))
    found = stereo(view.without_truth(), wanted, StereoDepth.of(wanted))
    errors = depth_errors(found.depth, view.depth[0])
    assert float(errors.median) < 1
    assert float(errors.above) < 18
    assert found.problems() == ()
