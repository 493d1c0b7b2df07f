"""What the tables of superpixels count beside the metrics."""

import importlib
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from experiments._superpixels import changed, plot_wrong, torn


def test_only_what_nothing_in_front_keeps_apart_is_torn():
    labels = np.full((1, 1, 6, 9), 3)
    labels[..., 1:5, 1:8] = 1
    labels[..., 1:5, 3:5] = 2
    disparity = np.zeros(labels.shape)
    assert torn(labels, disparity) == pytest.approx(1 / 3)
    disparity[..., 1:5, 3:5] = 1.0
    assert torn(labels, disparity) == 0
    # Behind, it hides nothing.
    assert torn(labels, -disparity) == pytest.approx(1 / 3)


def test_pieces_that_the_frame_cuts_are_not_torn():
    labels = np.full((1, 1, 6, 9), 5)
    labels[..., 2:, 3:6] = 8
    labels[..., :2, :] = 8
    assert torn(labels, np.zeros(labels.shape)) == 0


def test_other_numbers_of_the_same_superpixels_are_no_change():
    labels = np.repeat(np.arange(1, 5), 6).reshape(1, 1, 4, 6)
    assert changed(labels, 9 - labels) == 0
    others = labels.copy()
    others[..., 0, :2] = 2
    assert changed(labels, others) == pytest.approx(2 / 24)


def test_what_has_the_label_of_another_object_is_red():
    ids = np.zeros((1, 1, 4, 6), int)
    ids[..., 3:] = 1
    labels = np.ones_like(ids)
    labels[..., 2:] = 2
    picture = plot_wrong(labels, ids, (0, 0)).axes[0].images[0].get_array()
    assert picture is not None
    red = np.asarray(picture)[..., 0] > np.asarray(picture)[..., 1] + 0.5
    assert red[:, 2].all()
    assert red.sum() == 4


@pytest.fixture
def figure(monkeypatch):
    """The script of Fig. 5.4, which imports its neighbours by their names alone."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "experiments")
    return importlib.import_module("figure_5_4")


@pytest.mark.parametrize(
    ("method", "program"),
    [
        ("ours", "superpixels"),
        ("thesis", "thesis_superpixels"),
        ("k-means", "kmeans_superpixels"),
    ],
)
def test_a_sweep_varies_what_its_rows_say(figure, method, program, monkeypatch):
    given = []

    def caught(*arguments):
        given.extend(each for each in arguments if isinstance(each, figure.SWEPT[method]))
        return SimpleNamespace(labels=None)

    monkeypatch.setattr(figure, program, caught)
    views, depths = jnp.zeros((3, 3, 4, 4, 3)), jnp.zeros((3, 3, 4, 4))
    measured = figure.ViewDepths(depths, depths, depths, jnp.zeros((), jnp.int32))
    case = figure.Case(figure.LightField(views), measured, depths, depths)
    rows = figure._swept(f"{method}.color", ["3", "5"], size=12.0)
    for label, kind, params in rows:
        assert label.startswith(f"{method}, color ")
        figure.cut(kind, case, 12.0, params)
    assert [float(params.color) for params in given] == [3, 5]


@pytest.mark.parametrize(
    ("field", "text"),
    [
        ("SLIC projected.color", "a method must be one of .*, got 'SLIC projected'"),
        ("k-means.size", "k-means has position, disparity, color, fill; got 'size'"),
        ("thesis.lines", "thesis has position, disparity, color; got 'lines'"),
        ("nosuch", "ours has size, color, .* got 'nosuch'"),
    ],
)
def test_a_sweep_of_what_is_no_parameter_is_refused(figure, field, text):
    with pytest.raises(SystemExit, match=text):
        figure._swept(field, ["1"])
