"""Depth from views that are not on a regular grid: uneven rows, cells that are no squares."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from datasets.layouts import known, write_stanford
from edges.scenes import waves
from helpers import lean

from mvedge_jax import EdgeDepth, LightField, multiview_edges
from mvedge_jax._crosshair import crosshair
from mvedge_jax._params import cast
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.datasets import load_light_field, synthetic
from mvedge_jax.depth import estimate_depth
from mvedge_jax.edges import OrientedEdges
from mvedge_jax.edges.thesis import ThesisEdges
from mvedge_jax.metrics import depth_scores
from mvedge_jax.photometry import Noise, gather_evidence, recentred
from mvedge_jax.photometry.brightness import Exposure
from mvedge_jax.photometry.measuring import AdaptedMeasurement, CrosshairSplines, labels


def grid(rows, columns):
    """Positions of rows and columns of views."""
    return np.stack(np.meshgrid(columns, rows), axis=-1)


_EVEN = grid(np.arange(-1.0, 2), np.arange(-2.0, 3))
_UNEVEN = grid(np.array([-1.5, 0, 1.5]), np.array([-2.0, -1.3, 0, 0.8, 2]))
_DISPARITY = 0.37


def plane(positions, *, size=(24, 32), given=True, dtype=jnp.float32):
    """A textured plane as cameras at these positions see it."""
    y, x = np.mgrid[0 : size[0], 0 : size[1]].astype(float)
    views = [
        [waves(x + px * _DISPARITY, y + py * _DISPARITY, 0) for px, py in row] for row in positions
    ]
    return LightField(
        jnp.asarray(views, dtype),
        positions=positions if given else None,
        disparity_range=(0.0, 0.7),
    )


def measured(light_field, model):
    """The first measurement of every pixel."""
    evidence = gather_evidence(
        light_field, model.calibration, model.measurement, model.searched
    ).measured
    assert evidence is not None
    return evidence.disparity


@pytest.fixture(scope="module")
def model():
    return EdgeDepth.for_light_field(plane(_UNEVEN))


@pytest.fixture(scope="module")
def measure(model):
    return eqx.filter_jit(lambda light_field: measured(light_field, model))


def test_measurements_follow_the_positions(measure):
    inner = np.s_[3:-3, 4:-4]
    right = np.asarray(measure(plane(_UNEVEN)))[inner]
    assert np.median(np.abs(right - _DISPARITY)) < 0.003
    wrong = plane(_UNEVEN)
    wrong = eqx.tree_at(lambda s: s.positions, wrong, jnp.asarray(_EVEN, jnp.float32))
    assert np.median(np.abs(np.asarray(measure(wrong))[inner] - _DISPARITY)) > 0.02


def test_positions_of_a_regular_grid_are_no_positions(measure, model):
    given = measure(plane(_EVEN))
    none = eqx.filter_jit(lambda s: measured(s, model))(plane(_EVEN, given=False))
    np.testing.assert_allclose(given, none, atol=2e-5)


def test_the_gradient_in_the_positions():
    light_field = plane(_UNEVEN)
    lab = jnp.moveaxis(srgb_to_lab(light_field.centre_view), -1, 0)
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
        positions = _UNEVEN * [shrunk, 1]
        points = multiview_edges(plane(positions), model).points
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
    # The centre of the taps' positive half is ahead of the line by half a pixel or so.
    index = np.arange(-down.radius, down.radius + 1)
    for bank, own in ((across, steps[0]), (down, steps[1])):
        line = np.abs(np.asarray(bank.taps)) @ index / np.abs(np.asarray(bank.taps)).sum(-1)
        wanted = np.asarray(bank.disparity)[:, None] * np.asarray(own)[None]
        np.testing.assert_allclose(line, wanted, atol=1e-6)


def test_another_view_sees_the_others_from_its_own_place():
    light_field = plane(_UNEVEN)
    exposure = Exposure(jnp.ones((), jnp.float32), jnp.ones((3, 5), jnp.float32))
    noise = Noise.of(jnp.zeros((), jnp.float32))
    scene = recentred(light_field, jnp.asarray([0, 3]), exposure, noise)
    (across, down), (rows, columns) = scene.arms, (_UNEVEN[:, 3, 1], _UNEVEN[0, :, 0])
    np.testing.assert_allclose(np.sort(across.steps), np.sort(0.8 - columns), atol=1e-6)
    np.testing.assert_allclose(np.sort(down.steps), np.sort(-1.5 - rows), atol=1e-6)
    assert float(across.steps[across.centre]) == float(down.steps[down.centre]) == 0
    regular = recentred(plane(_EVEN, given=False), jnp.asarray([0, 3]), exposure, noise)
    given = recentred(plane(_EVEN), jnp.asarray([0, 3]), exposure, noise)
    for one, other in zip(regular.arms, given.arms, strict=True):
        np.testing.assert_array_equal(one.steps, other.steps)


def test_a_model_of_other_positions_is_refused(model):
    regular, uneven = plane(_EVEN, given=False), plane(_UNEVEN)
    for_regular = EdgeDepth.for_light_field(regular)
    assert isinstance(for_regular.edges, OrientedEdges)
    assert for_regular.edges.farthest is None
    with pytest.raises(ValueError, match="`model` is for views with `positions`, but those"):
        model(regular)
    with pytest.raises(ValueError, match="`model` is for views on a regular grid, but those"):
        for_regular(uneven)
    with pytest.raises(ValueError, match="views up to 2 view steps .* has views up to 4 away"):
        model(plane(2 * _UNEVEN))
    with pytest.raises(ValueError, match="the preset 'thesis' needs a regular grid"):
        EdgeDepth.for_light_field(uneven, preset="thesis")
    with pytest.raises(ValueError, match="`ThesisEdges` needs a regular grid"):
        model.replace(edges=ThesisEdges(reach=1.0, capacity=64))(uneven)


def rendered(folder, positions):
    """A scene as it was rendered, and as it is read from files in Stanford's naming."""
    light_field = synthetic.render(
        synthetic.scene("slanted"),
        shape=(*positions.shape[:2], 96, 96),
        positions=positions,
        samples=2,
        key=jax.random.key(0),
    )
    pixels = np.round(255 * np.asarray(light_field.views)).astype(np.uint8)
    return light_field, load_light_field(write_stanford(folder, pixels, places=60 * positions))


def _scores(read, truth, unit):
    """Scores of the full chain, in px per step of the truth."""
    low, high = (unit * float(end) for end in truth.disparity_range)
    ranged = eqx.tree_at(
        lambda s: s.disparity_range,
        read,
        jnp.asarray([low, high], read.views.dtype),
        is_leaf=lambda leaf: leaf is None,
    )
    found = estimate_depth(ranged, EdgeDepth.for_light_field(ranged)).disparity / unit
    scores = depth_scores(found, truth.truth.disparity, mask=truth.truth.valid)
    return np.asarray([scores.mse, scores.q25, scores.bad_07])


@pytest.mark.slow
def test_an_uneven_row_is_as_good_as_a_regular_one(tmp_path):
    even, one = np.arange(-8.0, 9), np.zeros(1)
    second = np.arange(17) % 2 == 1
    away = np.random.default_rng(0).uniform(-0.4, 0.4, 17)
    moved = even + np.where(second, away, 0)
    true, row = rendered(tmp_path / "even", grid(one, even))
    shown, uneven = rendered(tmp_path / "moved", grid(one, moved))
    assert row.positions is None
    assert uneven.positions is not None
    wanted = _scores(row, true, 1.0)
    found = _scores(uneven, shown, float(np.median(np.diff(moved))))
    assert (found < 1.1 * wanted).all(), (found, wanted)
    few, sparse = rendered(tmp_path / "sparse", grid(one, even[~second]))
    assert sparse.positions is None
    wanted = _scores(sparse, few, 2.0)
    apart = LightField(sparse.views, positions=grid(one, even[~second]))
    found = _scores(apart, few, 1.0)
    assert (found < 1.1 * wanted).all(), (found, wanted)


@pytest.mark.slow
def test_oblong_cells_are_as_good_as_squares(tmp_path):
    side = np.arange(-2.0, 3)
    square, read = rendered(tmp_path / "square", grid(side, side))
    wide, oblong = rendered(tmp_path / "oblong", grid(1.5 * side, side))
    assert read.positions is None
    np.testing.assert_allclose(known(oblong.positions), grid(1.5 * side, side), atol=1e-4)
    wanted, found = _scores(read, square, 1.0), _scores(oblong, wide, 1.0)
    assert (found < 1.05 * wanted).all(), (found, wanted)
