"""What the tables of superpixels count beside the metrics."""

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
