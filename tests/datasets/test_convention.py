"""The occlusion check tells a reversed view axis, and says so when it cannot tell."""

import cv2
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import shared_data

from mvedge_jax import LightField
from mvedge_jax.datasets import check_convention, load_light_field


def _texture(seed, size=192):
    noise = np.random.default_rng(seed).uniform(size=(size, size, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return (smooth - smooth.min()) / (smooth.max() - smooth.min())


def cards_of(near=1.5, far=-0.5, shape=(7, 7, 90, 100)):
    """Two textured cards before a textured wall, in the convention."""
    rows, columns, height, width = shape
    wall, card = (_texture(seed) for seed in (0, 1))
    views = np.zeros((*shape, 3), np.float32)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    for v, u in np.ndindex(rows, columns):
        du, dv = columns // 2 - u, rows // 2 - v
        back = cv2.remap(wall, x - du * far + 40, y - dv * far + 40, cv2.INTER_CUBIC)
        xc, yc = x - du * near, y - dv * near
        front = cv2.remap(card, xc + 40, yc + 40, cv2.INTER_CUBIC)
        covered = ((xc > 22) & (xc < 45) & (yc > 18) & (yc < 70)) | (
            (xc > 60) & (xc < 80) & (yc > 25) & (yc < 62)
        )
        views[v, u] = np.where(covered[..., None], front, back).clip(0, 1)
    return views


def _checked(views, **options):
    return check_convention(LightField(jnp.asarray(views), **options))


@pytest.fixture(scope="module")
def cards():
    """The scene in the order of the convention."""
    return cards_of()


@pytest.mark.parametrize("flip_v", [False, True])
@pytest.mark.parametrize("flip_u", [False, True])
def test_flips_and_exchanged_axes_are_found(cards, flip_v, flip_u):
    views = cards[:: -1 if flip_v else 1, :: -1 if flip_u else 1]
    check, exchanged = _checked(views), _checked(views.swapaxes(0, 1))
    assert (check.flip_u, check.flip_v, check.swap_axes) == (flip_u, flip_v, False)
    assert check.holds is not (flip_u or flip_v)
    assert exchanged.swap_axes
    assert exchanged.holds is False
    assert (exchanged.flip_u, exchanged.flip_v) == (flip_u, flip_v)
    assert exchanged.votes == check.votes


@pytest.mark.parametrize("gone", [[(3, 6), (1, 3)], [(3, 0), (3, 1), (3, 2)], "corners"])
def test_views_may_be_missing(cards, gone):
    if gone == "corners":
        gone = [(v, u) for v, u in np.ndindex(7, 7) if 3 not in (v, u)]
    assert check_convention(LightField(jnp.asarray(cards)).without_views(gone)).holds


def test_votes_and_range(cards):
    check = _checked(cards, disparity_range=(-0.8, 1.8))
    for votes in (check.columns, check.rows):
        assert votes[0] > 5
        assert votes[0] > 5 * votes[1]
    assert check.agreement[0] > 20
    assert check.agreement[1] == 0
    assert check.disparity_range == pytest.approx((-0.5, 1.5), abs=0.15)
    one, other = (_checked(v, disparity_range=(-2.0, 2.0)) for v in (cards, cards[:, ::-1]))
    assert other.columns == one.columns[::-1]
    assert other.rows == one.rows
    assert other.agreement == one.agreement[::-1]


def test_without_occlusions_nothing_is_claimed():
    plane, still = (
        cards_of(near=0.7, far=0.7),
        cards_of(near=0, far=0),
    )  # of two textures, one surface
    noise = np.random.default_rng(0).uniform(size=(5, 5, 40, 44, 3)).astype(np.float32)
    for views in (plane, noise):
        check = _checked(views)
        assert (check.holds, check.flip_u, check.flip_v) == (None, None, None)
    stripes = plane[:, :, :1].repeat(90, axis=2), still[:, :, :, :1].repeat(100, axis=3)
    for views in (still, *stripes):
        assert not _checked(views).swap_axes


@pytest.mark.parametrize("shape", [(1, 3, 32, 32, 3), (3, 3, 19, 32, 3)])
def test_too_little_to_look_at(shape):
    with pytest.raises(ValueError, match="3x3 views or more of at least 20x20 px"):
        _checked(jnp.zeros(shape))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "views"), [("hci/cotton", None), ("hci/backgammon", None), ("lytro/2067", 7)]
)
def test_real_scenes(place, views):
    folder = shared_data(*place.split("/"))
    for flip_u, flip_v in ((False, False), (True, False), (True, True)):
        light_field = load_light_field(folder, views=views, flip_u=flip_u, flip_v=flip_v)
        check = check_convention(light_field)
        assert (check.flip_u, check.flip_v) == (flip_u, flip_v), check
