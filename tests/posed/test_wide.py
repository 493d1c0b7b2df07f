"""Photographs so far apart that surfaces move by 15 to 30 px from one to the other."""

import jax.numpy as jnp
import numpy as np
import pytest
from posed.walls import room, turned

from mvedge_jax.depth.solves import Labels
from mvedge_jax.photometry.measuring import AdaptedMeasurement, PhotometricLabels
from mvedge_jax.posed import Photographs, StereoDepth, reference_of, stereo
from mvedge_jax.posed._labels import PhotographLabels
from mvedge_jax.posed.scores import depth_errors

SIZE, MATRIX = (60, 80), np.array([[75.0, 0, 39.5], [0, 75.0, 29.5], [0, 0, 1]])


def around(x, y=0.0, z=0.0):
    """A camera that looks at the middle of the room from one side."""
    yaw, pitch = (np.rad2deg(np.arctan2(side, 2.0)) for side in (-x, y))
    return turned(yaw=yaw, pitch=pitch, at=(x, y, z))


POSES = np.stack(
    [
        around(0),
        around(0.45, 0.05),
        around(-0.4, -0.03),
        around(0.75, -0.1, 0.1),
        around(-0.7, 0.08),
    ]
)


@pytest.fixture(scope="module")
def view():
    images, depths = room(POSES, matrix=MATRIX, size=SIZE)
    return Photographs(jnp.asarray(images, jnp.float32), POSES, MATRIX, depth=depths)


def test_a_room_with_a_steep_floor_is_found_from_15_to_30_px_apart(view):
    farthest = np.linalg.norm(POSES[:, :3, 3], axis=1)[1:]
    assert view.depth is not None
    moved = MATRIX[0, 0] * farthest / np.median(view.depth[0])
    assert (moved > 12).all()
    assert (moved < 30).all()
    wanted = reference_of(view, 0, depth_range=(0.9, 4.0))
    found = stereo(view.without_truth(), wanted, StereoDepth.of(wanted))
    errors = depth_errors(found.depth, view.depth[0])
    assert float(errors.median) < 1
    assert float(errors.above) < 18
    assert found.problems() == ()


@pytest.mark.parametrize(("variance", "value"), [(1e-8, 1.0), (1e4, 1.1)])
def test_hypotheses_count_where_the_measurement_fails(variance, value):
    one = jnp.ones((2, 3))
    found = PhotographLabels()(
        Labels(0.03 * one, 1.1 * one),
        PhotometricLabels(one, variance * one, 0 * one),
        one,
        AdaptedMeasurement(),
        jnp.asarray(0.02),
        None,
    )
    np.testing.assert_allclose(found.value, value, atol=1e-3)
