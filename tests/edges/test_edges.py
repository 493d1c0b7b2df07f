"""The whole point stage, on light fields whose disparity is known in closed form."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from edges.scenes import fence, flat_rectangle, plane, two_planes
from helpers import check_gradient, shared_data
from scipy import ndimage

from experiments._crossings import crossing_table, crossings, survive
from experiments.edge_accuracy import depth_edges
from mvedge_jax.datasets import synthetic
from mvedge_jax.depth import EdgeDepth, multiview_edges
from mvedge_jax.edges import OrientedEdges
from mvedge_jax.edges._range import RangeSearch, disparity_range
from mvedge_jax.lightfield import LightField


def _model(light_field, **choices):
    """The default chain, of which edge points are read; with the filters of `choices`, if any."""
    model = EdgeDepth.for_light_field(light_field)
    if not choices:
        return model
    return model.replace(edges=OrientedEdges(**choices))


def _flat(**choices):
    """Of `flat_plane`: one program for most tests."""
    return _model(
        plane(0.37, size=(32, 40)), **{"first": 0, "filters": 8, "capacity": 700} | choices
    )


@pytest.fixture(scope="module")
def flat_plane():
    return plane(0.37, size=(32, 40))


@pytest.fixture(scope="module")
def found(flat_plane):
    return multiview_edges(flat_plane, _flat())


def test_points_of_a_plane_are_precise(found):
    points = found.points
    keep, xy = np.asarray(points.valid), np.asarray(points.xy)
    error = np.abs(np.asarray(points.disparity) - 0.37)
    assert keep.sum() > 400
    assert np.median(error[keep]) < 0.001
    # At the border, half of the views of an arm do not show a point, nor half of its window.
    assert np.quantile(error[keep], 0.99) < 0.03
    inner = keep & np.all(np.abs(xy - [19.5, 15.5]) < [16, 12], axis=1)
    assert np.quantile(error[inner], 0.99) < 0.01
    # The standard error is honest within a factor of a few, and never optimistic by orders.
    assert np.median(error[keep] / np.asarray(points.error)[keep]) < 1.5
    assert np.quantile(error[keep] / np.asarray(points.error)[keep], 0.99) < 5
    assert np.asarray(points.visible)[inner].mean() > 0.98


def test_counts_add_up_and_padding_is_zero(found):
    stats, points = found.stats, found.points
    assert int(stats.valid) == int(points.valid.sum())
    assert int(stats.candidates) >= int(stats.consistent)
    assert int(stats.overflow) == 0
    empty = ~np.asarray(points.valid)
    assert empty.any()
    for name in ("xy", "disparity", "confidence", "error", "normal", "visible"):
        assert not np.asarray(getattr(points, name))[empty].any(), name


def test_confidence_and_normals_are_in_range(found):
    keep = np.asarray(found.points.valid)
    confidence = np.asarray(found.points.confidence)[keep]
    assert (confidence > 0).all()
    assert (confidence < 1).all()
    length = np.linalg.norm(np.asarray(found.points.normal)[keep], axis=1)
    np.testing.assert_allclose(length, 1, atol=1e-5)


def test_float32_stays_float32_and_is_close_to_float64(flat_plane, found):
    assert found.points.disparity.dtype == jnp.float32
    exact = multiview_edges(plane(0.37, size=(32, 40), dtype=jnp.float64), _flat())
    assert exact.points.disparity.dtype == jnp.float64
    both = np.asarray(exact.points.valid & found.points.valid)
    same = both & np.all(
        np.abs(np.asarray(exact.points.xy) - np.asarray(found.points.xy)) < 0.1, axis=1
    )
    assert same.sum() > 0.9 * np.asarray(found.points.valid).sum()
    difference = np.abs(np.asarray(exact.points.disparity) - np.asarray(found.points.disparity))[
        same
    ]
    assert np.quantile(difference, 0.95) < 2e-4


def test_overflow_keeps_the_strongest_and_is_counted(flat_plane, found):
    edges = multiview_edges(flat_plane, _flat(capacity=64))
    assert int(edges.stats.candidates) == int(found.stats.candidates)
    assert int(edges.stats.overflow) == int(edges.stats.candidates) - 64
    rows = np.asarray(edges.points.xy)[np.asarray(edges.points.valid), 1]
    assert rows.min() < 7
    assert rows.max() > 13


def test_a_wide_range_and_a_rectangular_grid_of_views_lose_nothing():
    light_field = plane(3.2, views=9, rows=5, size=(40, 56), span=(-3.5, 3.5))
    edges = multiview_edges(light_field, _model(light_field))
    keep = np.asarray(edges.points.valid)
    assert edges.points.visible.shape[1] == 14
    assert keep.sum() > 250
    assert np.mean(np.abs(np.asarray(edges.points.disparity)[keep] - 3.2) < 0.03) > 0.98


def test_both_sides_of_an_occluding_edge_are_found():
    light_field = two_planes(0.8, -0.6, edge=30.2)
    edges = multiview_edges(light_field, _model(light_field))
    keep = np.asarray(edges.points.valid)
    x, d = np.asarray(edges.points.xy)[keep, 0], np.asarray(edges.points.disparity)[keep]
    for side, truth in ((x < 29, 0.8), (x > 32, -0.6)):
        assert side.sum() > 40
        assert np.mean(np.abs(d[side] - truth) < 0.03) > 0.97
    # The occluding edge itself is there, with the disparity of the near surface, in every row.
    at_edge = (np.abs(x - 30) < 2) & (np.abs(d - 0.8) < 0.05)
    rows = np.rint(np.asarray(edges.points.xy)[keep, 1][at_edge])
    assert len(np.unique(rows)) >= 0.85 * 16


def _points(light_field):
    return multiview_edges(light_field, _model(light_field)).points


def test_both_lines_of_a_crossing_survive():
    """What counts as a crossing, and as surviving, stands in `experiments/_crossings.py`."""
    light_field, surfaces, disparity = fence(0.8, -0.6, slats=[(16.2, 24.4), (40.3, 46.8)])
    arm = np.asarray(light_field.horizontal_arm)
    found = crossings(arm, surfaces, disparity, view=4)
    far, near = survive(_points(light_field), found)
    assert len(far) > 40
    assert found.views.min() >= 3
    assert np.mean(far & near) >= 0.95


@pytest.mark.slow
def test_crossings_of_the_synthetic_scene_survive():
    """Must show 2."""
    light_field = synthetic.render(
        synthetic.scene("crossing"), shape=(9, 9, 192, 256), key=jax.random.key(0)
    )
    shown, hidden = crossing_table(light_field, _points)
    assert shown["crossings"] > 800
    assert shown["both %"] >= 95
    assert hidden["crossings"] > 400
    assert hidden["far line %"] >= 95


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["demo", "slanted", "edges", "thin", "wide", "crossing", "textureless", "noisy"]
)
def test_depth_edges_have_points(name):
    """Must show 1: nearly all depth edges, with the range found from the data."""
    light_field = synthetic.render(
        synthetic.scene(name), shape=(9, 9, 192, 256), key=jax.random.key(0)
    )
    truth = light_field.truth
    assert truth is not None
    blind = eqx.tree_at(
        lambda field: field.disparity_range,
        light_field.without_truth(),
        None,
        is_leaf=lambda leaf: leaf is None,
    )
    points = _points(blind)
    keep = np.asarray(points.valid)
    x, y = np.clip(np.rint(np.asarray(points.xy)[keep]).astype(int).T, 0, [[255], [191]])
    hit = np.ones((192, 256), bool)
    hit[y, x] = False
    near = np.asarray(ndimage.distance_transform_edt(hit)) <= 2
    assert near[depth_edges(np.asarray(truth.disparity))].mean() >= 0.85
    d = np.asarray(points.disparity)[keep]
    low, high = np.quantile(np.asarray(truth.disparity), [0.01, 0.99])
    assert np.mean((d > low - 0.5) & (d < high + 0.5)) > 0.97


def test_a_view_that_does_not_show_a_point_is_told(flat_plane):
    painted = flat_plane.views.at[2, 0].set(0.5)
    edges = multiview_edges(LightField(painted), _flat())
    keep = np.asarray(edges.points.valid)
    seen = np.asarray(edges.points.visible)[keep]
    assert keep.sum() > 40
    # A point of about the painted color does look the same there.
    assert seen[:, 5].mean() < 0.4
    assert seen[:, [2, 6, 7]].mean() > 0.95
    assert np.median(np.abs(np.asarray(edges.points.disparity)[keep] - 0.37)) < 0.01


def _scalar(points, keep):
    d = jnp.where(keep, points.disparity, 0)
    xy = jnp.where(keep[:, None], points.xy, 0)
    return (d + 0.3 * jnp.where(keep, points.confidence + 10 * points.error, 0)).sum() + (
        0.05 * jnp.sin(xy)
    ).sum()


@pytest.fixture(scope="module")
def tiny():
    """Few strong edges, so that no selection flips under the difference steps."""
    light_field = plane(0.27, views=3, size=(9, 13), dtype=jnp.float64)
    model = _model(light_field, first=0, filters=6, capacity=64)
    edges = multiview_edges(light_field, model)
    assert int(edges.stats.valid) > 5
    return light_field, model, edges.points.valid


def test_gradient_with_respect_to_views_taps_and_every_parameter(tiny):
    light_field, model, keep = tiny
    banks = model.edges.prewitt((3, 3), jnp.float64)
    model = model.replace({"edges.banks": banks})
    read = model.calibration, model.measurement, model.edges

    def loss(tree):
        views, (calibration, measurement, edges) = tree
        field = eqx.tree_at(lambda f: f.views, light_field, views)
        parts = {"calibration": calibration, "measurement": measurement, "edges": edges}
        return _scalar(multiview_edges(field, model.replace(parts)).points, keep)

    check_gradient(
        loss, (light_field.views, read), rtol=1e-4, step=1e-7, directions=3, key=jax.random.key(0)
    )


@pytest.mark.usefixtures("found")
def test_one_trace_for_many_values_and_vmap_is_a_loop(flat_plane):
    before, limits = multiview_edges.traces, [0.001, 0.003, 0.03]
    loop = [multiview_edges(flat_plane, _flat(error_limit=value)).points.valid for value in limits]
    # That of the fixture, or of another test, serves all of them.
    assert multiview_edges.traces == before
    together = jax.vmap(lambda value: multiview_edges(flat_plane, _flat(error_limit=value)))(
        jnp.asarray(limits)
    )
    np.testing.assert_array_equal(together.points.valid, jnp.stack(loop))


def test_the_range_is_found_from_the_data():
    light_field = plane(3.0, size=(64, 80))
    low, high = disparity_range(light_field)
    assert low < 3.0 < high
    assert high - low < 2.5


def test_filters_that_respond_beside_an_edge_do_not_widen_the_range():
    low, high = disparity_range(flat_rectangle(0.5))
    assert 0.0 < low < 0.5 < high < 1.0
    narrower = disparity_range(flat_rectangle(0.5), search=RangeSearch(tail=0.2))
    assert narrower[1] - narrower[0] <= high - low


def test_noise_makes_points_less_precise_but_does_not_remove_them(flat_plane, found):
    views = flat_plane.views
    grain = 0.03 * jax.random.normal(jax.random.key(0), views.shape, views.dtype)
    noisy = LightField(jnp.clip(views + grain, 0, 1))
    exact, rough = found.points, multiview_edges(noisy, _flat()).points
    keep = np.asarray(rough.valid)
    assert keep.sum() > 0.5 * np.asarray(exact.valid).sum()
    error = np.asarray(rough.error)[keep]
    assert (error > 0.03).any()
    # What the points claim about themselves is about right.
    off = np.abs(np.asarray(rough.disparity)[keep] - 0.37)
    assert 0.5 < np.median(off / (0.6745 * error)) < 2


def test_a_scene_without_edges_says_so():
    with pytest.raises(ValueError, match=r"`light_field` shows no edges.*`disparity_range`"):
        disparity_range(LightField(jnp.full((3, 3, 16, 16, 3), 0.5)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"filters": 2}, "`filters` must be at least 3, got 2"),
        ({"capacity": 0}, "`capacity` must be at least 1, got 0"),
        ({"spacing": 0.0}, "`spacing` must be positive, got 0"),
    ],
)
def test_impossible_sizes_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        OrientedEdges(**{"first": 0, "filters": 8, "capacity": 128} | change)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "least"), [("cotton", 90_000), ("backgammon", 110_000)])
def test_precision_on_the_benchmark(name, least):
    from mvedge_jax.datasets import load_light_field

    light_field = load_light_field(shared_data("hci", name))
    assert light_field.truth is not None
    truth = np.asarray(light_field.truth.disparity)
    blind = light_field.without_truth()
    points = multiview_edges(blind, _model(blind)).points
    keep = np.asarray(points.valid)
    x, y = np.clip(np.rint(np.asarray(points.xy)[keep]).astype(int), 0, 511).T
    padded = np.pad(truth, 1, mode="edge")
    d = np.asarray(points.disparity)[keep]
    error = np.min([np.abs(d - padded[y + j, x + i]) for j in range(3) for i in range(3)], axis=0)
    assert keep.sum() >= least
    assert np.median(error) <= 0.003
    assert np.mean(error < 0.07) >= 0.99
    assert np.mean(error > 0.5) <= 0.003
