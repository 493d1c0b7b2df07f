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


def _cards(near=1.5, far=-0.5, shape=(7, 7, 90, 100), contrast=1.0):
    """Two textured cards before a textured wall, in the convention."""
    rows, columns, height, width = shape
    wall, card = (0.5 + contrast * (_texture(seed) - 0.5) for seed in (0, 1))
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


@pytest.fixture(scope="module")
def cards():
    """The scene in the order of the convention."""
    return _cards()


@pytest.mark.parametrize("flip_v", [False, True])
@pytest.mark.parametrize("flip_u", [False, True])
def test_flips_are_found_on_either_axis(cards, flip_v, flip_u):
    views = cards[:: -1 if flip_v else 1, :: -1 if flip_u else 1]
    check = check_convention(LightField(jnp.asarray(views)))
    assert (check.flip_u, check.flip_v) == (flip_u, flip_v)
    assert check.holds is not (flip_u or flip_v)


@pytest.mark.parametrize("flip_v", [False, True])
@pytest.mark.parametrize("flip_u", [False, True])
def test_exchanged_axes_are_found_whatever_the_flips(cards, flip_v, flip_u):
    views = cards[:: -1 if flip_v else 1, :: -1 if flip_u else 1]
    check = check_convention(LightField(jnp.asarray(views.swapaxes(0, 1))))
    straight = check_convention(LightField(jnp.asarray(views)))
    assert check.swap_axes
    assert check.holds is False
    assert not straight.swap_axes
    assert (check.flip_u, check.flip_v) == (flip_u, flip_v)
    assert check.votes == straight.votes


def test_views_may_be_missing_on_the_crosshair(cards):
    light_field = LightField(jnp.asarray(cards))
    for gone in ([(3, 6), (1, 3)], [(3, 0), (3, 1), (3, 2)]):
        check = check_convention(light_field.without_views(gone))
        assert check.holds
    assert check_convention(LightField(jnp.asarray(cards.swapaxes(0, 1)))).swap_axes


def test_votes_and_range(cards):
    check = check_convention(LightField(jnp.asarray(cards), disparity_range=(-0.8, 1.8)))
    for votes in (check.columns, check.rows):
        assert votes[0] > 5
        assert votes[0] > 5 * votes[1]
    assert check.agreement[0] > 20
    assert check.agreement[1] == 0
    assert check.disparity_range == pytest.approx((-0.5, 1.5), abs=0.15)


def test_reversing_an_axis_reverses_its_votes(cards):
    one = check_convention(LightField(jnp.asarray(cards)), disparity_range=(-2.0, 2.0))
    other = check_convention(LightField(jnp.asarray(cards[:, ::-1])), disparity_range=(-2.0, 2.0))
    assert other.columns == one.columns[::-1]
    assert other.rows == one.rows
    assert other.agreement == one.agreement[::-1]


def test_crosshair_is_enough(cards):
    available = np.zeros((7, 7), bool)
    available[3], available[:, 3] = True, True
    views = np.where(available[..., None, None, None], cards, 0)
    assert check_convention(LightField(jnp.asarray(views), available=available)).holds


def test_without_occlusions_nothing_is_claimed():
    plane = _cards(near=0.7, far=0.7)  # still two textures, but one surface
    check = check_convention(LightField(jnp.asarray(plane)))
    assert check.holds is None
    assert (check.flip_u, check.flip_v) == (None, None)
    noise = np.random.default_rng(0).uniform(size=(5, 5, 40, 44, 3)).astype(np.float32)
    check = check_convention(LightField(jnp.asarray(noise)))
    assert check.holds is None
    still = _cards(near=0, far=0)
    for views in (still, still[:, :, :, :1].repeat(100, axis=3)):  # and stripes along x
        assert not check_convention(LightField(jnp.asarray(views))).swap_axes
    stripes = _cards(near=0.7, far=0.7)[:, :, :1].repeat(90, axis=2)
    assert not check_convention(LightField(jnp.asarray(stripes))).swap_axes


@pytest.mark.parametrize("shape", [(1, 3, 32, 32, 3), (3, 3, 19, 32, 3)])
def test_too_little_to_look_at(shape):
    with pytest.raises(ValueError, match="3x3 views or more of at least 20x20 px"):
        check_convention(LightField(jnp.zeros(shape)))


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
