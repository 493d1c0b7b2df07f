"""What the tables of superpixels count beside the metrics."""

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
