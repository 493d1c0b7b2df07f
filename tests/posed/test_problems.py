"""What a depth map of photographs says against itself."""

import numpy as np
import pytest

from mvedge_jax.posed._problems import depth_problems

DEPTH = np.full((4, 6), 2.0)


@pytest.mark.parametrize(
    ("share", "labelled", "texts"),
    [
        (0.04, 0.38, ()),
        (0.04, 0.18, ("82 % of the pixels have no accepted label",)),
        (0.12, 0.38, ("half of the pixels have a standard error above 12 % of their depth",)),
        (0.12, 0.0, ("100 % of the pixels have no accepted label", "above 12 % of their depth")),
        (np.inf, 0.0, ()),
        (np.nan, 0.0, ()),
    ],
)
def test_labels_and_errors_speak_against_a_map(share, labelled, texts):
    said = depth_problems(DEPTH, share * DEPTH, labelled)
    assert len(said) == len(texts)
    assert all(text in sentence for text, sentence in zip(texts, said, strict=True))


def test_a_few_pixels_of_no_known_depth_are_none():
    error = 0.03 * DEPTH
    error[0, 0] = np.inf
    assert depth_problems(DEPTH, error, 0.9) == ()
