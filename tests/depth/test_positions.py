"""Depth from views that are not on a regular grid: uneven rows, cells that are no squares."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from edges.scenes import waves

from mvedge_jax import EdgeDepth, LightField, multiview_edges
from mvedge_jax._crosshair import crosshair
from mvedge_jax.edges import OrientedEdges
from mvedge_jax.edges.thesis import ThesisEdges
from mvedge_jax.photometry import Noise, gather_evidence, recentred
from mvedge_jax.photometry.brightness import Exposure


def grid(rows, columns):
    """Positions of rows and columns of views."""
    return np.stack(np.meshgrid(columns, rows), axis=-1)


_EVEN = grid(np.arange(-1.0, 2), np.arange(-2.0, 3))
_UNEVEN = grid(np.array([-1.5, 0, 1.5]), np.array([-2.0, -1.3, 0, 0.8, 2]))
_DISPARITY = 0.37


def plane(positions, *, size=(24, 32), given=True):
    """A textured plane as cameras at these positions see it."""
    y, x = np.mgrid[0 : size[0], 0 : size[1]].astype(float)
    views = [
        [waves(x + px * _DISPARITY, y + py * _DISPARITY, 0) for px, py in row] for row in positions
    ]
    known = positions if given else None
    return LightField(jnp.asarray(views, jnp.float32), positions=known, disparity_range=(0.0, 0.7))


@pytest.fixture(scope="module")
def model():
    return EdgeDepth.for_light_field(plane(_UNEVEN))


def test_measurements_follow_the_positions(model):
    @eqx.filter_jit
    def measure(light_field):
        """The first measurement of every pixel."""
        parts = model.calibration, model.measurement, model.searched
        found = gather_evidence(light_field, *parts).measured
        assert found is not None
        return found.disparity

    def off(light_field):
        return np.median(np.abs(np.asarray(measure(light_field)) - _DISPARITY)[3:-3, 4:-4])

    assert off(plane(_UNEVEN)) < 0.003
    even = jnp.asarray(_EVEN, jnp.float32)
    assert off(eqx.tree_at(lambda s: s.positions, plane(_UNEVEN), even)) > 0.02


def test_positions_of_one_shape_share_a_program(model):
    before = multiview_edges.traces
    for shrunk in (1.0, 0.9):
        points = multiview_edges(plane(_UNEVEN * [shrunk, 1]), model).points
        off = np.abs(np.asarray(points.disparity) - _DISPARITY)[np.asarray(points.valid)]
        assert off.size > 100
        assert np.median(off) < 0.005
    assert multiview_edges.traces <= before + 1


def test_another_view_sees_the_others_from_its_own_place():
    exposure = Exposure(jnp.ones((), jnp.float32), jnp.ones((3, 5), jnp.float32))
    noise = Noise.of(jnp.zeros((), jnp.float32))

    def arms(light_field):
        return recentred(light_field, jnp.asarray([0, 3]), exposure, noise).arms

    (across, down), (rows, columns) = (arms(plane(_UNEVEN)), (_UNEVEN[:, 3, 1], _UNEVEN[0, :, 0]))
    np.testing.assert_allclose(np.sort(across.steps), np.sort(0.8 - columns), atol=1e-6)
    np.testing.assert_allclose(np.sort(down.steps), np.sort(-1.5 - rows), atol=1e-6)
    assert float(across.steps[across.centre]) == float(down.steps[down.centre]) == 0
    # Positions of a regular grid are no positions.
    for of in (arms, crosshair):
        for one, other in zip(of(plane(_EVEN, given=False)), of(plane(_EVEN)), strict=True):
            np.testing.assert_array_equal(one.steps, other.steps)


def test_a_model_of_other_positions_is_refused(model):
    regular, uneven = plane(_EVEN, given=False), plane(_UNEVEN)
    for_regular = EdgeDepth.for_light_field(regular)
    assert isinstance(for_regular.edges, OrientedEdges)
    assert for_regular.edges.farthest is None
    thesis = model.replace(edges=ThesisEdges(reach=1.0, capacity=64))
    for call, field, match in (
        (model, regular, "`model` is for views with `positions`, but those"),
        (for_regular, uneven, "`model` is for views on a regular grid, but those"),
        (model, plane(2 * _UNEVEN), "views up to 2 view steps .* has views up to 4 away"),
        (thesis, uneven, "`ThesisEdges` needs a regular grid"),
    ):
        with pytest.raises(ValueError, match=match):
            call(field)
    with pytest.raises(ValueError, match="the preset 'thesis' needs a regular grid"):
        EdgeDepth.for_light_field(uneven, preset="thesis")
