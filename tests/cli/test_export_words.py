"""What `mvedge export` says that it wrote."""

import numpy as np
import pytest
from posed.walls import MATRIX, POSES, wall

from mvedge_jax.cli._export import _written
from mvedge_jax.cli._gathered import Gathered
from mvedge_jax.posed import Photographs

IMAGES, DEPTHS = wall(POSES)


@pytest.mark.parametrize(
    ("report", "text"),
    [
        ({"form": "ply", "points": {"a": 1728}}, "1 point cloud (a.ply), 1728 points"),
        (
            {"form": "ply", "points": dict.fromkeys("abcd", 5)},
            "4 point clouds (a.ply, b.ply, c.ply, ...), 20 points",
        ),
        ({"form": "colmap"}, "4 views with their cameras, 0 points"),
        ({"form": "nerfstudio"}, "4 views with their cameras, 0 points, depth of 1"),
    ],
)
def test_what_is_written_is_said(report, text):
    views = Photographs(IMAGES.astype(np.float32), POSES, MATRIX)
    assert _written(Gathered(views, {1: DEPTHS[1]}, {}), report) == text
