"""Losses: their terms against loops and scikit-image, masks, derivatives, features."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient
from numpy.testing import assert_allclose, assert_array_equal
from skimage.metrics import structural_similarity

from mvedge_jax.lightfield import LightField
from mvedge_jax.losses import (
    LossWeights,
    SupervisedWeights,
    Views,
    all_views,
    gather_views,
    occlusion_masks,
    self_supervised_loss,
    supervised_loss,
    terms,
)
from mvedge_jax.losses.features import Colors, FilterBank, load_vgg16
from mvedge_jax.warping import backward_warp

ssim = jax.jit(terms.ssim)
edge_aware_smoothness = jax.jit(terms.edge_aware_smoothness)
reprojection_error = eqx.filter_jit(terms.reprojection_error)


def smooth_light_field(shape=(12, 15), disparity=0.6):
    """A textured plane of constant disparity, sampled exactly."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    views = np.zeros((3, 3, *shape, 3))
    for v, u, c in np.ndindex(3, 3, 3):
        px, py = x - (1 - u) * disparity, y - (1 - v) * disparity
        views[v, u, ..., c] = 0.5 + 0.3 * np.sin(0.5 * px + c) * np.cos(0.4 * py - c)
    return LightField(jnp.asarray(views))


def test_views_are_the_crosshair_and_the_true_disparity_explains_them():
    light_field = smooth_light_field()
    views = gather_views(light_field)
    assert_array_equal(views.steps, [[0, 1], [0, -1], [1, 0], [-1, 0]])

    @jax.jit
    def loss(d):
        return self_supervised_loss(
            jnp.full((12, 15), d), views, LossWeights(gradient=jnp.asarray(0.0))
        )[0]

    found = [float(loss(d)) for d in (0.4, 0.6, 0.8)]
    assert found[1] < 0.5 * min(found[0], found[2])
    assert found[1] < 0.01  # what bilinear interpolation leaves


def test_reprojection_error_is_the_mean_over_visible_views():
    rng = np.random.default_rng(0)
    image = jnp.asarray(rng.random((3, 7, 9)))
    others = jnp.asarray(rng.random((2, 3, 7, 9)))
    views = Views(image, others, jnp.array([[1.0, 0.0], [0.0, -2.0]]), jnp.ones(2, bool))
    disparity = jnp.asarray(rng.normal(size=(7, 9)))
    visible = jnp.asarray(rng.random((2, 7, 9)) > 0.4)
    found = reprojection_error(disparity, views, visible, Colors())
    total, count = np.zeros((7, 9)), np.zeros((7, 9))
    for k in range(2):
        warped, _ = backward_warp(jnp.moveaxis(others[k], 0, -1), disparity, views.steps[k])
        difference = np.abs(np.asarray(warped) - np.moveaxis(np.asarray(image), 0, -1)).mean(-1)
        total += np.where(visible[k], difference, 0)
        count += np.asarray(visible[k])
    assert_allclose(found, total / np.maximum(count, 1), atol=1e-12)


@pytest.mark.parametrize("features", [Colors(), FilterBank()], ids=["colors", "bank"])
def test_gradient_of_every_term(features):
    light_field = smooth_light_field((9, 10))
    views = gather_views(light_field)
    disparity = 0.5 + 0.1 * jax.random.normal(jax.random.key(0), (9, 10))
    visible = jax.jit(occlusion_masks)(disparity, views)
    weights = LossWeights(dissimilarity=jnp.asarray(0.3))

    def loss(tree):
        return self_supervised_loss(
            tree[0], views, tree[1], visible=visible, features=features, similarity=True
        )[0]

    check_gradient(loss, (disparity, weights), rtol=1e-5, key=jax.random.key(1), directions=2)


@pytest.mark.parametrize("similarity", [False, True])
def test_missing_views_do_not_count(similarity):
    light_field = smooth_light_field()
    one, two = (gather_views(light_field, choice=c) for c in ([(1, 0)], [(1, 0), (0, 1)]))
    two = eqx.tree_at(lambda v: v.available, two, jnp.array([True, False]))
    weights = LossWeights(dissimilarity=jnp.asarray(0.3))

    @jax.jit
    def value(disparity, views):
        return self_supervised_loss(disparity, views, weights, similarity=similarity)[0]

    disparity, run = jnp.full((12, 15), 0.2), jax.jit(jax.value_and_grad(value))
    (a, slope_a), (b, slope_b) = run(disparity, one), run(disparity, two)
    assert float(a) == pytest.approx(float(b), rel=1e-12)
    assert_allclose(slope_a, slope_b, atol=1e-12)
    nothing = eqx.tree_at(lambda v: v.available, two, jnp.zeros(2, bool))
    assert bool(jnp.isfinite(value(disparity, nothing)))


def test_ssim_equals_scikit_image_away_from_the_border():
    rng = np.random.default_rng(0)
    a = rng.random((3, 24, 27))
    b = np.clip(a + 0.1 * rng.normal(size=a.shape), 0, 1)
    expected = structural_similarity(
        a, b, channel_axis=0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
        data_range=1.0, full=True,
    )[1]  # fmt: skip # pyright: ignore
    found = ssim(jnp.asarray(a), jnp.asarray(b))
    assert_allclose(found[5:-5, 5:-5], expected.mean(0)[5:-5, 5:-5], atol=1e-10)
    assert_allclose(ssim(jnp.asarray(a), jnp.asarray(a)), 1, atol=1e-12)


def test_supervised_loss_skips_unknown_pixels():
    truth = jnp.array([[0.0, jnp.nan], [1.0, 2.0]])
    known = jnp.isfinite(truth)
    disparity = jnp.array([[0.5, 9.0], [1.0, 4.0]])
    weights = SupervisedWeights(square=jnp.asarray(10.0))
    value, gradient = jax.value_and_grad(supervised_loss)(disparity, truth, known, weights)
    assert float(value) == pytest.approx((2.5 + 10 * 4.25) / 3)
    assert bool(jnp.isfinite(gradient).all())
    assert float(gradient[0, 1]) == 0
    nothing = supervised_loss(disparity, truth, jnp.zeros_like(known), weights)
    assert float(nothing) == 0


def test_vgg_runs_on_a_users_weights_and_says_what_is_wrong(tmp_path):
    rng = np.random.default_rng(0)
    arrays = {
        "features.0.weight": rng.normal(size=(64, 3, 3, 3)),
        "features.0.bias": rng.normal(size=64),
        "features.2.weight": rng.normal(size=(64, 64, 3, 3)),
        "features.2.bias": rng.normal(size=64),
    }
    with pytest.raises(FileNotFoundError, match="no file of VGG16 weights"):
        load_vgg16(tmp_path / "none.npz")
    for changed, message in (
        ({**arrays, "features.0.bias": np.zeros(3)}, r"'features.0.bias' .* has the shape \(3,\)"),
        ({"features.0.bias": np.zeros(64)}, r"has no array 'features.0.weight'"),
    ):
        np.savez(tmp_path / "bad.npz", **changed)  # pyright: ignore
        with pytest.raises(ValueError, match=message):
            load_vgg16(tmp_path / "bad.npz")
    np.savez(tmp_path / "good.npz", **arrays)  # pyright: ignore
    out = load_vgg16(tmp_path / "good.npz")(jnp.full((3, 6, 7), 0.5))
    assert out.shape == (64, 6, 7)
    assert float(out.min()) >= 0
    assert_allclose(out[:, 2, 3], out[:, 3, 3], atol=1e-9)


def test_all_views_leaves_out_the_center_and_what_is_missing():
    available = jnp.ones((3, 3), bool).at[0, 0].set(False)
    light_field = LightField(jnp.zeros((3, 3, 4, 5, 3)), available=available)
    chosen = all_views(light_field)
    assert len(chosen) == 7
    assert (1, 1) not in chosen
    assert gather_views(light_field, choice=chosen).steps.shape == (7, 2)


@pytest.mark.parametrize(
    ("choice", "message"), [([], "names no view"), ([(3, 0)], r"view \(3, 0\); the grid is 3x3")]
)
def test_bad_choice_of_views(choice, message):
    with pytest.raises(ValueError, match=message):
        gather_views(smooth_light_field((4, 5)), choice=choice)
