"""Depth from views that are not on a regular grid: uneven rows, cells that are no squares."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from datasets.layouts import write_stanford
from edges.scenes import waves
from helpers import lean
from numpy.testing import assert_allclose, assert_array_equal

from mvedge_jax import EdgeDepth, LightField, multiview_edges
from mvedge_jax._crosshair import crosshair
from mvedge_jax._params import cast
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.datasets import load_light_field, synthetic
from mvedge_jax.depth import estimate_depth
from mvedge_jax.edges import OrientedEdges
from mvedge_jax.edges.thesis import ThesisEdges
from mvedge_jax.metrics import depth_scores
from mvedge_jax.photometry import Noise, gather_evidence, recenterd
from mvedge_jax.photometry.brightness import Exposure
from mvedge_jax.photometry.measuring import AdaptedMeasurement, CrosshairSplines, labels


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


@pytest.mark.slow
def test_the_gradient_in_the_positions():
    light_field = plane(_UNEVEN)
    lab = jnp.moveaxis(srgb_to_lab(light_field.center_view), -1, 0)
    first = jnp.full(lab.shape[1:], 0.36, lab.dtype)
    params = cast(AdaptedMeasurement(radius=2), first.dtype)

    def mean(positions):
        moved = eqx.tree_at(lambda s: s.positions, light_field, positions)
        found = CrosshairSplines.of(crosshair(moved)).accumulate(first, params)
        found = labels(found, lab, first, params, passes=1)
        return jnp.mean(found.disparity[3:-3, 4:-4])

    positions = light_field.positions
    value, slope = lean(jax.value_and_grad(mean))(positions)
    assert float(value) == pytest.approx(_DISPARITY, abs=0.003)
    assert bool(jnp.isfinite(slope).all())
    # What is twice as far apart has half the disparity: the derivative along the positions is -d.
    assert float(jnp.sum(slope * positions)) == pytest.approx(-_DISPARITY, rel=0.1)


def test_positions_of_one_shape_share_a_program(model):
    before = multiview_edges.traces
    for shrunk in (1.0, 0.9):
        points = multiview_edges(plane(_UNEVEN * [shrunk, 1]), model).points
        off = np.abs(np.asarray(points.disparity) - _DISPARITY)[np.asarray(points.valid)]
        assert off.size > 100
        assert np.median(off) < 0.005
    assert multiview_edges.traces <= before + 1


def test_filters_follow_the_positions(model):
    assert isinstance(model.edges, OrientedEdges)
    assert model.edges.farthest == 2
    steps = jnp.asarray(-_UNEVEN[0, :, 0]), jnp.asarray(-_UNEVEN[:, 0, 1])
    across, down = model.edges.prewitt((3, 5), jnp.float64, steps=steps)
    assert across.taps.shape[1:] == (5, across.taps.shape[2])
    # The center of the taps' positive half is ahead of the line by half a pixel or so.
    index = np.arange(-down.radius, down.radius + 1)
    for bank, own in ((across, steps[0]), (down, steps[1])):
        weight = np.abs(np.asarray(bank.taps))
        wanted = np.asarray(bank.disparity)[:, None] * np.asarray(own)[None]
        assert_allclose(weight @ index / weight.sum(-1), wanted, atol=1e-6)


def test_another_view_sees_the_others_from_its_own_place():
    exposure = Exposure(jnp.ones((), jnp.float32), jnp.ones((3, 5), jnp.float32))
    noise = Noise.of(jnp.zeros((), jnp.float32))

    def arms(light_field):
        return recenterd(light_field, jnp.asarray([0, 3]), exposure, noise).arms

    (across, down), (rows, columns) = arms(plane(_UNEVEN)), (_UNEVEN[:, 3, 1], _UNEVEN[0, :, 0])
    assert_allclose(np.sort(across.steps), np.sort(0.8 - columns), atol=1e-6)
    assert_allclose(np.sort(down.steps), np.sort(-1.5 - rows), atol=1e-6)
    assert float(across.steps[across.center]) == float(down.steps[down.center]) == 0
    # Positions of a regular grid are no positions.
    for of in (arms, crosshair):
        for one, other in zip(of(plane(_EVEN, given=False)), of(plane(_EVEN)), strict=True):
            assert_array_equal(one.steps, other.steps)


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


def _scores(folder, positions, unit, *, given=False):
    """Scores of the chain on a rendered scene, in px per step of the truth, and read positions.

    It is read from files in Stanford's naming, as `unit` steps of which one of the truth counts;
    with `given`, its positions are told besides.
    """
    truth = synthetic.render(
        synthetic.scene("slanted"),
        shape=(*positions.shape[:2], 96, 96),
        positions=positions,
        samples=2,
        key=jax.random.key(0),
    )
    assert truth.truth is not None
    assert truth.disparity_range is not None
    pixels = np.round(255 * np.asarray(truth.views)).astype(np.uint8)
    read = load_light_field(write_stanford(folder, pixels, places=60 * positions))
    low, high = (unit * float(end) for end in truth.disparity_range)
    places = positions if given else read.positions
    field = LightField(read.views, positions=places, disparity_range=(low, high))
    found = estimate_depth(field, EdgeDepth.for_light_field(field)).disparity / unit
    scores = depth_scores(found, truth.truth.disparity, mask=truth.truth.valid)
    return np.asarray([scores.mse, scores.q25, scores.bad_07]), read.positions


@pytest.mark.slow
@pytest.mark.parametrize("name", ["row", "sparse row", "cells"])
def test_uneven_rows_and_oblong_cells_are_as_good_as_regular_ones(tmp_path, name):
    even, one, side = np.arange(-8.0, 9), np.zeros(1), np.arange(-2.0, 3)
    second = np.arange(17) % 2 == 1
    moved = even + np.where(second, np.random.default_rng(0).uniform(-0.4, 0.4, 17), 0)
    pitch = float(np.median(np.diff(moved)))
    sparse, cells = grid(one, even[~second]), grid(1.5 * side, side)
    regular, other, told, bar = {
        "row": ((grid(one, even), 1.0), (grid(one, moved), pitch), False, 1.1),
        "sparse row": ((sparse, 2.0), (sparse, 1.0), True, 1.1),
        "cells": ((grid(side, side), 1.0), (cells, 1.0), False, 1.05),
    }[name]
    wanted, none = _scores(tmp_path / "regular", *regular)
    found, positions = _scores(tmp_path / "other", *other, given=told)
    assert none is None
    assert (positions is None) == told
    if name == "cells":
        assert_allclose(np.asarray(positions), cells, atol=1e-4)
    assert (found < bar * wanted).all(), (found, wanted)
