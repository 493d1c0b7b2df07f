"""Edits: cards of known depth, drawn as they should come out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient
from scipy import ndimage

from mvedge_jax.edit import insert_picture, paint, remove
from mvedge_jax.lightfield import LightField

_NEAR, _FAR = 1, -1


def _cards(shape=(3, 3, 24, 32)):
    """A card at disparity 1 before a wall at -1, with their colors and depth in every view."""
    rows, columns, height, width = shape
    rng = np.random.default_rng(1)
    wall = rng.uniform(0.5, 1, (height + 8, width + 8, 3))
    y, x = np.mgrid[:height, :width]
    views, depth = np.zeros((*shape, 3)), np.zeros(shape)
    plain = np.zeros_like(views)
    for v, u in np.ndindex(rows, columns):
        a, b = columns // 2 - u, rows // 2 - v
        on = (abs(y - b * _NEAR - 12) < 5) & (abs(x - a * _NEAR - 16) < 5)
        plain[v, u] = wall[4 + y - b * _FAR, 4 + x - a * _FAR]
        views[v, u] = np.where(on[..., None], [0.3, 0.1, 0.1], plain[v, u])
        depth[v, u] = np.where(on, _NEAR, _FAR)
    return LightField(jnp.asarray(views)), jnp.asarray(depth), jnp.asarray(plain)


@pytest.mark.parametrize("disparity", [0.0, 2.0])
def test_a_picture_is_hidden_by_what_is_nearer_and_nothing_else_changes(disparity):
    field, depth, _ = _cards()
    picture = jnp.zeros((7, 15, 4)).at[..., 1::2].set(1.0)
    found = insert_picture(field, depth, picture, at=(20.0, 12.0), disparity=disparity)
    y, x = np.mgrid[:24, :32]
    for v, u in np.ndindex(3, 3):
        a, b = (1 - u) * disparity, (1 - v) * disparity
        inside = (abs(x - 20 - a) <= 7) & (abs(y - 12 - b) <= 3)
        expected = inside & (np.asarray(depth[v, u]) < disparity)
        changed = (np.asarray(found.views[v, u]) != np.asarray(field.views[v, u])).any(-1)
        np.testing.assert_array_equal(changed, expected)
        np.testing.assert_allclose(
            np.asarray(found.views[v, u])[expected], [[0, 1, 0]] * expected.sum()
        )


def test_a_slanted_picture_is_where_its_plane_says():
    field, depth, _ = _cards()
    picture = jnp.zeros((1, 21, 4)).at[0, 17].set(1.0)
    found = insert_picture(field, depth, picture, at=(14.0, 2.0), disparity=1.0, slant=(1 / 7, 0.0))
    # Seven pixels to the right of its middle the plane has the disparity 2.
    for u in range(3):
        change = np.abs(np.asarray(found.views - field.views)[1, u, 2]).max(-1)
        assert abs(int(np.argmax(change)) - (21 + 2 * (1 - u))) <= 1
        assert (change > 0).sum() <= 3


def test_half_transparent_pictures_mix():
    field, depth, _ = _cards()
    picture = jnp.ones((3, 3, 4)).at[..., 3].set(0.25)
    found = insert_picture(field, depth, picture, at=(4.0, 4.0), disparity=0.0)
    np.testing.assert_allclose(
        found.views[1, 1, 4, 4], 0.25 + 0.75 * field.views[1, 1, 4, 4], rtol=1e-12
    )


def test_paint_goes_on_where_the_center_view_does_not_show_the_surface():
    field, depth, _ = _cards()
    wall = np.asarray(depth == _FAR)
    mask = jnp.asarray(wall[1, 1], field.views.dtype)
    found = paint(field, depth, mask, jnp.asarray([0.0, 0.0, 1.0]), shaded=False)
    painted = np.abs(np.asarray(found.views) - [0, 0, 1]).max(-1) < 1e-9
    np.testing.assert_array_equal(painted, wall)
    assert not painted[~wall].any()
    # Of a wall that is painted on the left only, what is uncovered right of the card stays.
    left = jnp.where(jnp.arange(32)[None] < 16, mask, 0)
    found = paint(field, depth, left, jnp.asarray([0.0, 0.0, 1.0]), shaded=False)
    changed = (np.asarray(found.views) != np.asarray(field.views)).any(-1)
    assert not changed[:, :, 9:16, 18:].any()
    assert not changed[~wall].any()


def test_what_is_removed_shows_what_other_views_saw():
    field, depth, plain = _cards((5, 5, 24, 32))
    found = remove(field, depth, depth[2, 2] == _NEAR)
    on = np.asarray(depth == _NEAR)
    np.testing.assert_array_equal(np.asarray(found.views)[~on], np.asarray(field.views)[~on])
    # Nothing of the card is left; what any view saw of the wall is exact.
    error = np.abs(np.asarray(found.views - plain)).max(-1)
    assert (np.asarray(found.views)[on].min(-1) >= 0.5 - 1e-9).all()
    assert (error[on] < 1e-9).mean() > 0.75


def test_what_blends_with_what_is_removed_goes_with_it_in_every_view():
    field, depth, _ = _cards((5, 5, 24, 32))
    on = np.asarray(depth == _NEAR)
    # A rim of the card's color all around it, in every view.
    rim = ndimage.binary_dilation(on, np.ones((1, 1, 3, 3), bool)) & ~on
    views = jnp.where(rim[..., None], jnp.asarray([0.3, 0.1, 0.1]), field.views)
    found = remove(LightField(views), depth, depth[2, 2] == _NEAR, radius=2)
    assert (np.asarray(found.views).min(-1) >= 0.5 - 1e-9).all()


def _wall(disparity, shape=(3, 3, 12, 14)):
    """A wall of one color between whole disparities."""
    return LightField(jnp.full((*shape, 3), 0.4)), jnp.full(shape, disparity)


def test_nothing_from_beyond_the_frame_mixes_in():
    field, depth = _wall(0.3)
    white, everywhere = jnp.ones(3), jnp.ones((12, 14))
    painted = paint(field, depth, everywhere, white, shaded=False)
    np.testing.assert_allclose(painted.views, 1, rtol=1e-12)
    # A card in the corner, half of a pixel of whose places other views see beyond their frame.
    card = depth.at[:, :, :4, :4].set(2.0)
    gone = remove(field, card, card[1, 1] == 2.0)
    np.testing.assert_allclose(gone.views, 0.4, rtol=1e-12)


def test_paint_stays_at_its_end_of_the_wall():
    """A view's corner that no row or column of the center view reaches is not the other corner."""
    field, depth = _wall(2.0)
    corner = jnp.zeros((12, 14)).at[:6, :6].set(1.0)
    found = paint(field, depth, corner, jnp.ones(3), shaded=False)
    changed = np.any(np.asarray(found.views != field.views), axis=-1)
    assert changed[:, :, :3, :3].all()
    assert not changed[:, :, 8:].any()
    assert not changed[:, :, :, 8:].any()


def test_derivatives_equal_differences():
    """Of what is transparent, and of a mask of zeros, too."""
    field, depth, _ = _cards()
    weights = jax.random.normal(jax.random.key(1), field.views.shape)
    picture = jax.random.uniform(jax.random.key(0), (5, 5, 4)).at[:2, :, 3].set(0.0)

    def loss(tree):
        views, image, at, disparity, mask = tree
        put = insert_picture(field, depth, image, at=at, disparity=disparity)
        painted = paint(field, depth, mask, jnp.full(3, 0.9), shaded=False)
        removed = remove(LightField(views), depth, depth[1, 1] == _NEAR)
        return jnp.sum(weights * (put.views + painted.views + removed.views))

    mask = jnp.zeros(depth.shape[2:])
    tree = (field.views, picture, jnp.asarray([10.3, 5.6]), jnp.asarray(0.27), mask)
    check_gradient(loss, tree, rtol=1e-6, step=1e-6, key=jax.random.key(2))


def test_the_mask_leaves_the_precision_of_the_views():
    field, depth = _wall(0.3)
    single = LightField(field.views.astype(jnp.float32))
    painted = paint(single, depth.astype(jnp.float32), jnp.ones((12, 14)), jnp.ones(3))
    assert painted.views.dtype == jnp.float32


def test_what_is_wholly_transparent_has_a_derivative():
    field, depth = _wall(0.3)
    weights = jax.random.normal(jax.random.key(1), field.views.shape)

    def loss(tree):
        alpha, mask = tree
        picture = jnp.concatenate([jnp.full((5, 5, 3), 0.9), alpha[..., None]], axis=-1)
        put = insert_picture(field, depth, picture, at=(6.2, 5.1), disparity=1.2)
        painted = paint(field, depth, mask, jnp.full(3, 0.9), shaded=False)
        return jnp.sum(weights * (put.views + painted.views))

    tree = (jnp.zeros((5, 5)), jnp.zeros((12, 14)))
    check_gradient(loss, tree, rtol=1e-6, step=1e-6, key=jax.random.key(2))


def test_what_is_removed_has_a_gradient():
    field, depth, _ = _cards()
    weights = jax.random.normal(jax.random.key(1), field.views.shape)

    def loss(views):
        found = remove(LightField(views), depth, depth[1, 1] == _NEAR)
        return jnp.sum(weights * found.views)

    check_gradient(loss, field.views, rtol=1e-6, step=1e-3, key=jax.random.key(2))
