"""Plots: what is drawn is what was passed, on shared scales, with nothing left behind."""

import inspect
import io
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.collections import LineCollection

from mvedge_jax import plotting
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import ViewConsistency, boundary_scores, calibration


def _array(artist: Any) -> Any:
    return artist.get_array()


def _draw(figure):
    """Rasterizes a figure: constrained layout and color bars run only then."""
    figure.savefig(io.BytesIO(), format="png", dpi=40)


def _scene(shape=(3, 5, 12, 17)):
    return LightField(np.random.default_rng(0).random((*shape, 3)))


def _maps():
    rng = np.random.default_rng(1)
    truth = np.linspace(-1, 1, 12 * 17).reshape(12, 17)
    return truth, [truth + 0.02 * rng.normal(size=truth.shape) for _ in range(2)]


def _images(figure):
    return [image for axes in figure.axes for image in axes.images]


def test_views_are_where_their_labels_say():
    scene = _scene().without_views([(0, 0)])
    figure = plotting.plot_views(scene)
    (mosaic,) = _images(figure)
    pixels = _array(mosaic)
    assert pixels.shape == (3 * 16 - 4, 5 * 21 - 4, 3)
    np.testing.assert_allclose(pixels[16:28, 21:38], scene.views[1, 1])
    assert (pixels[:12, :17] == pixels[0, 0]).all()  # the missing view is one flat gray
    assert 0 < pixels[0, 0].min() < 1
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == list("01234")
    _draw(figure)
    (small,) = _images(plotting.plot_views(_scene(), pixels=30))
    assert _array(small).shape == (3 * 8 - 4, 5 * 9 - 4, 3)


@pytest.mark.parametrize("along", ["row", "column"])
def test_epi_lines_have_the_slope_of_the_convention(along):
    scene = _scene()
    options: Any = {
        along: 6,
        "positions": jnp.array([4.0, 9.0, 2.0]),
        "disparities": jnp.array([1.0, -0.5, 0.0]),
        "valid": jnp.array([True, True, False]),
    }
    figure = plotting.plot_epi(scene, **options)
    lower = figure.axes[1]
    epi = _array(lower.images[0])
    expected = scene.views[1, :, 6] if along == "row" else scene.views[:, 2, :, 6]
    np.testing.assert_allclose(epi, expected)
    collections = [c for c in lower.collections if isinstance(c, LineCollection)]
    segments = collections[-1].get_segments()
    assert len(segments) == 2
    center = 2 if along == "row" else 1
    for segment, at, d in zip(segments, (4.0, 9.0), (1.0, -0.5), strict=True):
        np.testing.assert_allclose(segment[:, 0], at + (center - segment[:, 1]) * d)
    _draw(figure)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"row": 1, "column": 2}, "exclude each other"),
        ({"positions": jnp.zeros(3)}, "belong together"),
        ({"row": 99}, "`row` must be from 0 to"),
        ({"row": -1}, "`row` must be from 0 to"),
        ({"column": 99}, "`column` must be from 0 to"),
    ],
)
def test_an_epi_that_is_not_there_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        plotting.plot_epi(_scene(), **options)


def test_edges_are_colored_by_disparity_and_near_ones_are_on_top():
    image = np.random.default_rng(2).random((12, 17, 3))
    points = jnp.array([[3.0, 4.0], [10.0, 2.0], [5.0, 5.0]])
    depth, valid = jnp.array([0.5, -0.5, 9.0]), jnp.array([True, True, False])
    figure = plotting.plot_edges(
        image, points, depth, valid=valid, limits=(-1.0, 1.0), name="edges"
    )
    dots: Any = figure.axes[0].collections[0]
    np.testing.assert_allclose(dots.get_offsets(), [[10, 2], [3, 4]])
    np.testing.assert_allclose(_array(dots), [-0.5, 0.5])
    assert dots.get_clim() == (-1.0, 1.0)
    _draw(figure)


def test_maps_of_a_scene_share_range_colors_and_bar():
    truth, maps = _maps()
    maps[0][3, 4] = np.nan
    figure = plotting.plot_disparity([truth, *maps], names=["truth", "a", "b"])
    images = _images(figure)[:3]
    assert len({image.get_clim() for image in images}) == 1
    assert len({image.get_cmap().name for image in images}) == 1
    assert figure.axes[-1].get_ylabel() == "disparity (px per view step)"
    assert np.ma.getmaskarray(_array(images[1]))[3, 4]
    fixed = plotting.plot_disparity(maps[1], limits=(-2.0, 2.0), label="of its own")
    assert _images(fixed)[0].get_clim() == (-2.0, 2.0)
    assert fixed.axes[-1].get_ylabel() == "of its own"
    _draw(figure)
    with pytest.raises(ValueError, match="`names` must have one entry"):
        plotting.plot_disparity(maps, names=["a"])


def test_limits_ignore_outliers_and_survive_empty_maps():
    values = np.linspace(0.0, 1.0, 1001)[None]
    low, high = plotting.disparity_limits([values, np.full((1, 3), np.nan)], percent=10.0)
    assert (low, high) == pytest.approx((0.1, 0.9))
    assert plotting.disparity_limits([np.full((2, 2), np.nan)]) == (0.0, 1.0)
    low, high = plotting.disparity_limits([np.ones((2, 2))])
    assert low < 1 < high


def test_errors_show_sign_size_and_gaps():
    truth, maps = _maps()
    signed = _images(plotting.plot_error(maps[0], truth, kind="signed", limit=0.05))[0]
    np.testing.assert_allclose(_array(signed), maps[0] - truth)
    assert signed.get_clim() == (-0.05, 0.05)
    spoilt = maps[0].copy()
    spoilt[0, 0], spoilt[1, 1] = np.inf, truth[1, 1]
    figure = plotting.plot_error(spoilt, truth, name="a", label="standard error")
    assert [bar.get_ylabel() for bar in figure.axes[1:]] == ["standard error"]
    size = _array(_images(figure)[0])
    assert np.ma.getmaskarray(size)[0, 0]
    assert not np.ma.getmaskarray(size)[1, 1]  # an exact pixel is dark, not missing
    np.testing.assert_allclose(size[2:], np.abs(spoilt - truth)[2:])
    _draw(figure)
    with pytest.raises(ValueError, match="`kind` must be"):
        inspect.unwrap(plotting.plot_error)(spoilt, truth, kind="relative")
    with pytest.raises(ValueError, match="`truth` must have the shape"):
        inspect.unwrap(plotting.plot_error)(spoilt, truth[1:])


def test_comparison_has_a_column_per_method():
    truth, maps = _maps()
    image = np.zeros((12, 17, 3))
    figure = plotting.plot_comparison(
        maps, truth, names=["a", "b"], captions=["1", "2"], image=image
    )
    assert [axes.get_title() for axes in figure.axes[:3]] == ["ground truth", "a", "b"]
    assert [axes.get_xlabel() for axes in figure.axes[3:6]] == ["center view", "1", "2"]
    limits = {image.get_clim() for axes in figure.axes[:3] for image in axes.images}
    assert limits == {(-1.0, 1.0)}
    np.testing.assert_allclose(_array(figure.axes[5].images[0]), np.abs(maps[1] - truth))
    _draw(figure)


def test_precision_recall_curves_are_the_scores():
    truth = jnp.zeros((12, 17)).at[:, 8:].set(1.0)
    noise = 0.3 * jnp.asarray(np.random.default_rng(3).normal(size=(12, 17)))
    scores = [boundary_scores(truth, truth), boundary_scores(truth + noise, truth)]
    figure = plotting.plot_precision_recall(scores, names=["exact", "noisy"])
    axes = figure.axes[0]
    curves: list[Any] = [line for line in axes.lines if str(line.get_label())[0] != "_"]
    assert [line.get_label() for line in curves] == ["exact (1.00)", curves[1].get_label()]
    seen = np.asarray(scores[1].recall) > 0
    np.testing.assert_allclose(curves[1].get_xdata(), scores[1].recall[seen])
    np.testing.assert_allclose(curves[1].get_ydata(), scores[1].precision[seen])
    _draw(figure)


def test_consistency_shares_one_scale_and_leaves_out_missing_views():
    grids = [np.linspace(0.1, 0.5, 9).reshape(3, 3), np.linspace(0.2, 0.9, 9).reshape(3, 3)]
    grids[0][0, 0] = np.nan
    scores = [ViewConsistency(jnp.asarray(g), jnp.ones((3, 3)), jnp.nanmean(g)) for g in grids]
    figure = plotting.plot_consistency(scores, names=["a", "b"])
    images = _images(figure)[:2]
    assert {image.get_clim() for image in images} == {(0, 0.9)}
    lines: list[Any] = list(figure.axes[0].lines)
    medians = [y for line in lines if line.get_color() == "black" for y in line.get_ydata()]
    assert np.nanmedian(grids[0]) in medians
    assert np.median(grids[1]) in medians
    _draw(figure)


def test_calibration_is_drawn_beside_the_diagonal():
    truth, maps = _maps()
    sigma = jnp.linspace(0.01, 0.03, truth.size).reshape(truth.shape)
    found = [calibration(jnp.asarray(m), sigma, jnp.asarray(truth), groups=4) for m in maps]
    figure = plotting.plot_calibration(found, names=["a", "b"])
    left, right = figure.axes
    for each, line in zip(found, left.lines[1:], strict=True):
        np.testing.assert_allclose(np.asarray(line.get_xdata()), each.predicted)
        np.testing.assert_allclose(np.asarray(line.get_ydata()), each.found)
    np.testing.assert_allclose(np.asarray(right.lines[0].get_ydata()), found[0].sparsified)
    labels = [str(line.get_label()) for line in left.lines[1:]]
    both = [f"({100 * each.within[1]:.0f} %, {each.ause:.2f})" for each in found]
    assert labels == [f"a {both[0]}", f"b {both[1]}"]
    with pytest.raises(ValueError, match="names"):
        plotting.plot_calibration(found, names=["a"])
    _draw(figure)
    for nothing in ([], [found[0]._replace(predicted=np.full(4, np.inf), found=np.zeros(4))]):
        with pytest.raises(ValueError, match="no pixel of a finite standard error"):
            plotting.plot_calibration(nothing)


def _superpixels():
    """Gray views of two superpixels, and a pixel of none."""
    labels = np.ones((3, 3, 8, 9), int)
    labels[..., 4:] = 2
    labels[..., 0, 0] = 0
    return np.full((3, 3, 8, 9, 3), 0.2), labels


def test_superpixels_are_outlined_or_filled_with_their_colors():
    views, labels = _superpixels()
    outlined = plotting.superpixel_picture(views[1, 1], labels[1, 1], outline=(1.0, 0.0, 0.0))
    red = (outlined == [255, 0, 0]).all(-1)
    assert red[:, 4].all()
    assert red.sum() == 8 + 2  # and around the pixel without a label
    colors = plotting.label_colors(200)
    assert len(np.unique(np.round(255 * colors), axis=0)) > 190
    filled = plotting.superpixel_picture(views[1, 1], labels[1, 1], colors=colors, outline=None)
    expected = [*np.round(255 * colors[:2]), [51, 51, 51]]
    np.testing.assert_array_equal([filled[3, 2], filled[3, 7], filled[0, 0]], expected)


def test_superpixels_of_all_views_and_labels_per_pixel_are_drawn():
    views, labels = _superpixels()
    figure = plotting.plot_superpixels(views, labels, colors=plotting.label_colors(2))
    assert len(_images(figure)) == 5
    _draw(figure)
    assert len(plotting.superpixel_frames(views, labels)) == 8
    assert len(plotting.superpixel_frames(views[:1], labels[:1])) == 5
    figure = plotting.plot_labels_per_pixel(np.full((4, 5), 2.0))
    assert [image.get_clim() for image in _images(figure)] == [(1, 8)]
    _draw(figure)
