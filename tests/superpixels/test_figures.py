"""What the tables of superpixels count beside the metrics."""

import importlib
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from experiments._superpixels import changed, torn


def test_pieces_are_torn_unless_something_in_front_or_the_frame_keeps_them_apart():
    labels = np.full((1, 1, 6, 9), 3)
    labels[..., 1:5, 1:8] = 1
    labels[..., 1:5, 3:5] = 2
    disparity = np.zeros(labels.shape)
    disparity[..., 1:5, 3:5] = 1.0
    for depth, share in ((0 * disparity, 1 / 3), (disparity, 0), (-disparity, 1 / 3)):
        assert torn(labels, depth) == pytest.approx(share)
    labels = np.full((1, 1, 6, 9), 5)
    labels[..., 2:, 3:6] = labels[..., :2, :] = 8
    assert torn(labels, 0 * disparity) == 0


def test_other_numbers_of_the_same_superpixels_are_no_change():
    labels = np.repeat(np.arange(1, 5), 6).reshape(1, 1, 4, 6)
    assert changed(labels, 9 - labels) == 0
    others = labels.copy()
    others[..., 0, :2] = 2
    assert changed(labels, others) == pytest.approx(2 / 24)


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
