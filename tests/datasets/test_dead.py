"""Views that do not show the scene are told from those that do, and take no part."""

import jax.numpy as jnp
import numpy as np
import pytest
from cli.scenes import textured_plane
from datasets.layouts import write_grid, write_h5

from mvedge_jax import LightField, load_light_field
from mvedge_jax.datasets import find_dead_views


def _plane(disparity=0.7, grid=(5, 5)):
    """A textured plane, sRGB in [0, 1]."""
    plane = textured_plane(40, 48, disparity=disparity, grid=grid) / np.float32(255)
    return plane.clip(0.05, 0.95)


def _found(views, **options):
    return find_dead_views(LightField(jnp.asarray(views), **options))


def _spoiled(views, place, what):
    views, rng = views.copy(), np.random.default_rng(1)
    view = views[place]
    views[place] = {
        "black": np.zeros_like(view),
        "white": np.ones_like(view),
        "of one color": np.broadcast_to([0.1, 0.2, 0.9], view.shape),
        "a lens cap": rng.uniform(0, 6 / 255, view.shape),
        "saturated": np.where(rng.uniform(size=view.shape[:2]) < 0.98, 1, view[..., 0])[..., None],
        "the same picture as view (v, u) = (0, 1)": views[0, 1],
    }[what]
    return views


@pytest.mark.parametrize("place", [(2, 4), (0, 0), (2, 2)])
@pytest.mark.parametrize("what", ["black", "white", "of one color", "a lens cap", "saturated"])
def test_what_shows_nothing_is_named(place, what):
    found = _found(_spoiled(_plane(), place, what))
    assert found == {place: "black" if what == "a lens cap" else what}


def test_repetitions_are_named_and_most_of_the_views_may_be_dead():
    same = "the same picture as view (v, u) = "
    views = _plane()
    views[2, 3] = views[2, 2]  # the center is right
    assert _found(views) == {(2, 3): same + "(2, 2)"}
    views[0, 0] = views[4, 4]  # one of these is
    assert _found(views)[0, 0] == same + "(4, 4)"
    assert _found(views)[4, 4] == same + "(0, 0)"
    views, gone = _plane(grid=(3, 3)), [(0, 0), (0, 1), (1, 0), (2, 0), (2, 1), (2, 2)]
    views[tuple(zip(*gone, strict=True))] = 0
    assert _found(views) == dict.fromkeys(gone, "black")


ALIKE = {
    "gray": np.full((5, 5, 32, 32, 3), 0.5),
    "black": np.zeros((3, 3, 32, 32, 3)),
    "no parallax": _plane(disparity=0),
    "tiny baselines": _plane(disparity=0.002),
    "dark": _plane() * 0.04,
    "gains": _plane() * np.linspace(0.15, 1, 25).reshape(5, 5, 1, 1, 1),
    "8 bits": np.round(_plane(disparity=0) * 255) / 255,
    "stars": np.where(_plane() > 0.9, 0.9, 0),
    "rows alike": np.broadcast_to(_plane()[:, :1], (5, 5, 40, 48, 3)),
    "a noisy wall": 0.6 + np.random.default_rng(0).normal(0, 0.005, (5, 5, 32, 32, 3)),
    "a single row": _plane(grid=(1, 5)),
}


@pytest.mark.parametrize("name", ALIKE)
def test_views_that_are_legitimately_alike_are_left_alone(name):
    assert _found(np.asarray(ALIKE[name], np.float32)) == {}


def test_half_a_picture_is_left_out_where_the_others_are_whole():
    views = _plane()
    views[2, 4, :, :24] = 0
    views[2, 0, :4] = 0
    views[0, 0, :20] = 1  # bright, and of its own accord no outlier
    assert _found(views) == {(2, 4): "black in 50 % of its pixels"}
    views[:, :, :20] = 0  # a mask of the lens
    assert _found(views)[2, 4].startswith("black in 7")
    assert len(_found(views)) == 1


def test_missing_views_are_not_looked_at():
    available = np.ones((5, 5), bool)
    available[0, 0] = False
    assert _found(_spoiled(_plane(), (0, 0), "black"), available=available) == {}


def _bytes(views):
    return np.round(255 * views).astype(np.uint8)


def test_the_reader_leaves_dead_views_out_and_names_them(tmp_path):
    views = _spoiled(_spoiled(_plane(), (2, 4), "black"), (1, 0), "white")
    views[3, 3] = views[2, 2]
    folder = write_grid(tmp_path / "toy", _bytes(views), pattern="v_{}_{}.png", first=0)
    message = (
        "toy: 3 of 25 views left out as missing, as they do not show the scene: v_1_0.png is "
        "white; v_2_4.png is black; v_3_3.png is the same picture as v_2_2.png."
    )
    with pytest.warns(UserWarning, match="toy") as said:
        found = load_light_field(folder)
    assert [str(one.message) for one in said] == [message]
    expected = np.ones((5, 5), bool)
    expected[2, 4] = expected[1, 0] = expected[3, 3] = False
    np.testing.assert_array_equal(np.asarray(found.available), expected)
    assert not np.asarray(found.views)[~expected].any()
    with pytest.warns(UserWarning, match="v_3_3"):
        flipped = load_light_field(folder, flip_u=True)
    np.testing.assert_array_equal(np.asarray(flipped.available), expected[:, ::-1])


def test_the_place_in_a_container_is_named(tmp_path):
    path = write_h5(tmp_path / "toy.h5", _bytes(_spoiled(_plane(), (1, 2), "black")))
    with pytest.warns(UserWarning, match=r"1 of 25 views.*: toy\.h5: LF\[1, 2\] is black\."):
        load_light_field(path)


def test_a_dead_or_lone_center_view_is_an_error(tmp_path):
    folder = write_grid(tmp_path / "dead", _bytes(_spoiled(_plane(), (2, 2), "black")))
    with pytest.raises(ValueError, match=r"lf_03_03\.png, the center view, is black, unlike"):
        load_light_field(folder)
    views = _bytes(_plane(grid=(3, 3)))
    views[1, [0, 2]] = views[[0, 2], 1] = 0
    folder = write_grid(tmp_path / "lone", views)
    with pytest.raises(ValueError, match="all 4 are missing"), pytest.warns(match="4 of 9"):
        load_light_field(folder)
