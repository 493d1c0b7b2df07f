"""The parts of the centre view's reconstruction: labels, smoothness, hypotheses, median."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, count_traces
from scipy import ndimage

from mvedge_jax._crosshair import crosshair
from mvedge_jax.epi._spline import spline_coefficients
from mvedge_jax.lightfield import LightField
from mvedge_jax.reconstruct import (
    MedianParams,
    PhotometricParams,
    Sharpening,
    SmoothnessParams,
    VolumeParams,
    edge_smoothness,
    hypotheses,
    photometric_labels,
    sharpen,
    weighted_median,
)
from mvedge_jax.reconstruct._paths import aggregate
from mvedge_jax.reconstruct._sharpen import _box_sum


def with_values(parameters, **values):
    """Parameters with some numbers set."""
    return parameters(**{name: jnp.asarray(value) for name, value in values.items()})


def plane_arms(disparity, *, views=(5, 5), size=(20, 28), noise=0.0, seed=0, splines=True):
    """Arms of a fronto-parallel plane with a smooth random texture, sampled from a spline."""
    rng = np.random.default_rng(seed)
    pad = 10
    texture = rng.uniform(size=(size[0] + 2 * pad, size[1] + 2 * pad, 3))
    texture = ndimage.gaussian_filter(texture, (1.2, 1.2, 0)) * 2 - 0.5
    y, x = np.mgrid[0 : size[0], 0 : size[1]].astype(float) + pad
    grid = np.zeros((*views, *size, 3))
    for v, u in np.ndindex(*views):
        place = [y - (views[0] // 2 - v) * disparity, x - (views[1] // 2 - u) * disparity]
        for c in range(3):
            grid[v, u, ..., c] = ndimage.map_coordinates(texture[..., c], place, order=3)
    grid += noise * rng.standard_normal(grid.shape)
    arms = crosshair(LightField(jnp.asarray(np.clip(grid, 0, 1))))
    if not splines:
        return arms
    return tuple(a._replace(planes=spline_coefficients(a.planes, axis=-1)) for a in arms)


def test_a_photometric_step_finds_the_plane_and_knows_how_well():
    truth, start = 0.31, 0.28
    errors, predicted = [], []
    for seed in range(3):
        arms = plane_arms(truth, noise=0.01, seed=seed)
        labels = photometric_labels(
            arms[0],
            arms[1],
            jnp.full((20, 28), start),
            with_values(PhotometricParams, noise=0.01),
            radius=2,
            passes=2,
        )
        inner = (slice(4, -4), slice(4, -4))
        errors.append((np.asarray(labels.disparity) - truth)[inner])
        predicted.append(np.sqrt(np.asarray(labels.variance))[inner])
    error = np.sqrt(np.mean(np.square(errors)))
    assert error < 0.25 * (truth - start)
    assert 0.5 < error / np.sqrt(np.mean(np.square(predicted))) < 2


def test_missing_views_take_no_part():
    across, down = plane_arms(0.2)
    there = across.available.at[0].set(False)
    params = PhotometricParams()
    disparity = jnp.full((20, 28), 0.15)

    def measure(planes):
        arm = across._replace(planes=planes, available=there)
        return photometric_labels(arm, down, disparity, params, radius=2, passes=1).disparity

    junk = across.planes.at[0].set(0.123)
    np.testing.assert_array_equal(measure(across.planes), measure(junk))
    gradient = jax.grad(lambda p: measure(p).sum())(across.planes)
    assert float(jnp.abs(gradient[0]).max()) == 0
    assert float(jnp.abs(gradient[1]).max()) > 0


def test_flat_images_leave_the_map_alone_and_say_so():
    arms = plane_arms(0.0)
    flat = tuple(a._replace(planes=jnp.full_like(a.planes, 0.5)) for a in arms)
    labels = photometric_labels(
        flat[0], flat[1], jnp.full((20, 28), 0.4), PhotometricParams(), radius=2, passes=2
    )
    np.testing.assert_allclose(labels.disparity, 0.4, atol=1e-9)
    assert float(labels.variance.min()) > 1


def test_gradient_of_the_measurement_matches_differences():
    across, down = plane_arms(0.2, views=(3, 3), size=(8, 9))
    disparity = 0.15 + 0.01 * jnp.sin(jnp.arange(72.0).reshape(8, 9))

    def loss(tree):
        planes, disparity, params = tree
        found = photometric_labels(
            across._replace(planes=planes), down, disparity, params, radius=2, passes=1
        )
        return jnp.sum(found.disparity**2) + jnp.sum(1 / (1 + 1e4 * found.variance))

    tree = (across.planes, disparity, PhotometricParams())
    check_gradient(loss, tree, rtol=1e-5, step=1e-6, key=jax.random.key(1))


def test_hypotheses_find_both_sides_of_an_occlusion_edge():
    # A near card (d = 1) in front of a far wall (d = -0.5), both with their own texture.
    rng = np.random.default_rng(3)
    wall, card = (
        ndimage.gaussian_filter(rng.uniform(size=(60, 60, 3)), (0.7, 0.7, 0)) for _ in "ab"
    )
    views = np.zeros((5, 5, 32, 40, 3))
    y, x = np.mgrid[0:32, 0:40]
    for v, u in np.ndindex(5, 5):
        k, j = 2 - u, 2 - v
        # d = -0.5 is drawn with nearest samples of a texture at twice the resolution.
        far = np.kron(wall, np.ones((2, 2, 1)))[2 * y + j + 8, 2 * x + k + 8]
        near = card[y - j + 4, x - k + 4]
        inside = (x - k >= 12) & (x - k < 28) & (y - j >= 8) & (y - j < 24)
        views[v, u] = np.where(inside[..., None], near, far)
    arms = crosshair(LightField(jnp.asarray(views)))
    truth = np.where((x >= 12) & (x < 28) & (y >= 8) & (y < 24), 1.0, -0.5)
    lab = 100 * jnp.moveaxis(jnp.asarray(views[2, 2]), -1, 0)
    tried = jnp.linspace(-1, 1.5, 11)
    found = hypotheses(*arms, lab, tried, VolumeParams(), window=2)
    assert float(found.min()) >= -1
    assert float(found.max()) <= 1.5
    inner = (slice(4, -4), slice(4, -4))
    wrong = (np.abs(np.asarray(found) - truth) > 0.13)[inner]
    assert wrong.mean() < 0.06


def test_hypotheses_do_not_see_a_missing_view():
    across, down = plane_arms(0.5, splines=False)
    lab = 100 * across.planes[2]
    there = across.available.at[0].set(False)
    tried = jnp.linspace(-1, 1, 41)
    found = [
        hypotheses(
            across._replace(planes=across.planes.at[0].set(value), available=there),
            down,
            lab,
            tried,
            VolumeParams(),
            window=1,
        )
        for value in (0.0, 0.9)
    ]
    np.testing.assert_array_equal(found[0], found[1])
    assert float((jnp.abs(found[0] - 0.5) < 0.01).mean()) > 0.95


def test_paths_are_the_cheapest_of_all_paths():
    # Brute force along a row: every sequence of disparities that ends at the last pixel.
    rng = np.random.default_rng(4)
    cost, lab = rng.uniform(size=(3, 1, 5)), 10 * rng.uniform(size=(3, 1, 5))
    slant, jump, colour = 0.1, 0.5, 6.0
    found = aggregate(
        jnp.asarray(cost),
        jnp.asarray(lab),
        slant=jnp.asarray(slant),
        jump=jnp.asarray(jump),
        colour=jnp.asarray(colour),
    )
    steps = np.linalg.norm(np.diff(lab[:, 0], axis=1), axis=0)
    prices = jump / (1 + steps / colour)

    def price(path):
        moves = np.abs(np.diff(path))
        change = np.where(moves == 0, 0, np.where(moves == 1, np.minimum(slant, prices), prices))
        return sum(cost[d, 0, i] for i, d in enumerate(path)) + change.sum()

    paths = np.array(list(np.ndindex(*[3] * 5)))
    prices_of_paths = np.array([price(path) for path in paths])
    ends = np.array([prices_of_paths[paths[:, -1] == d].min() for d in range(3)])
    # The aggregate is normalised along the path, and holds the vertical and the backward paths too,
    # which at the last pixel of a single row are the pixel's own cost.
    expected = ends + 3 * cost[:, 0, -1]
    last = np.asarray(found)[:, 0, -1]
    np.testing.assert_allclose(last - last.min(), expected - expected.min(), atol=1e-6)


def test_a_plain_surface_follows_its_surroundings():
    across, down = plane_arms(0.5, splines=False)
    hole = np.s_[..., 6:14, 10:18]
    planes = across.planes.at[hole].set(0.5), down.planes.at[..., 10:18, 6:14].set(0.5)
    arms = across._replace(planes=planes[0]), down._replace(planes=planes[1])
    # Colours alike, so that nothing but the neighbours can fill the hole in the texture.
    found = hypotheses(
        *arms, jnp.zeros((3, 20, 28)), jnp.linspace(-1, 1, 9), VolumeParams(), window=1
    )
    assert float(jnp.median(jnp.abs(found[6:14, 10:18] - 0.5))) < 0.1


def test_smoothness_needs_both_steps_to_cut():
    lab = jnp.zeros((3, 1, 5)).at[0, 0, 2:].set(40.0)
    depth = jnp.array([[0.0, 0.0, 1.0, 1.0, 1.0]])
    params = SmoothnessParams()
    both, _ = edge_smoothness(lab, depth, params)
    colour, _ = edge_smoothness(lab, jnp.zeros_like(depth), params)
    step, _ = edge_smoothness(jnp.zeros_like(lab), depth, params)
    assert float(both[0, 1]) < 1e-4
    assert float(colour.min()) > 0.99
    assert float(step.min()) > 0.99
    # The formula, written out.
    expected = 1 / (1 + (40 / 0.3) ** 1.5 * (1 / 0.05) ** 2)
    assert float(both[0, 1]) == pytest.approx(max(expected, 1e-6), rel=1e-3)


def test_smoothness_gradient_matches_differences_and_is_finite_when_flat():
    key = jax.random.key(0)
    lab = 10 * jax.random.normal(key, (3, 5, 6))
    depth = 0.1 * jax.random.normal(jax.random.key(1), (5, 6))

    def loss(tree):
        lab, depth, logs = tree
        params = jax.tree.map(jnp.exp, logs)
        tx, ty = edge_smoothness(lab, depth, params)
        return jnp.sum(jnp.sqrt(tx)) + jnp.sum(jnp.sqrt(ty))

    logs = jax.tree.map(jnp.log, SmoothnessParams())
    check_gradient(loss, (lab, depth, logs), rtol=1e-5, step=1e-6, key=key)
    flat = jax.grad(loss)((jnp.zeros((3, 4, 4)), jnp.zeros((4, 4)), logs))
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(flat))


@pytest.mark.parametrize("radius", [1, 2, 4, 7])
def test_box_sums_agree_with_scipy(radius):
    image = np.random.default_rng(radius).uniform(size=(11, 17))
    width = 2 * radius + 1
    expected = ndimage.uniform_filter(image, width, mode="constant") * width**2
    np.testing.assert_allclose(_box_sum(jnp.asarray(image), radius), expected, atol=1e-12)


def blurred_step():
    x = np.arange(40)
    step = np.where(x < 20, -0.5, 0.7)
    guide = np.where(x < 20, 0.2, 0.8)[None, None] * np.ones((3, 24, 1))
    ramp = np.interp(x, [17, 22], [-0.5, 0.7])
    return jnp.asarray(np.tile(ramp, (24, 1))), jnp.asarray(guide), step


def test_sharpening_moves_a_blurred_step_onto_the_colour_step():
    blurred, guide, step = blurred_step()
    before = np.abs(np.asarray(blurred) - step).mean()
    modes: tuple[Sharpening, ...] = ("clip", "median", "quantised")
    for mode in modes:
        sharp = sharpen(blurred, guide, MedianParams(), radius=6, mode=mode)
        assert np.abs(np.asarray(sharp) - step).mean() < 0.4 * before
    same = sharpen(blurred, guide, MedianParams(), mode="none")
    np.testing.assert_array_equal(same, blurred)


def test_clip_keeps_precision_where_there_is_nothing_to_sharpen():
    y, x = np.mgrid[0:24, 0:30]
    slope = jnp.asarray(0.003 * x + 0.001 * y)
    guide = jnp.asarray(np.random.default_rng(0).uniform(size=(3, 24, 30)))
    np.testing.assert_allclose(sharpen(slope, guide, MedianParams(), radius=5), slope, atol=5e-3)
    gradient = jax.grad(lambda d: sharpen(d, guide, MedianParams(), radius=3).sum())(slope)
    assert bool(jnp.isfinite(gradient).all())
    assert float(gradient.mean()) > 0.5


def test_median_of_a_constant_is_the_constant():
    guide = jnp.asarray(np.random.default_rng(0).uniform(size=(3, 9, 7)))
    for quantised in (False, True):
        found = weighted_median(
            jnp.full((9, 7), 0.3), guide, jnp.array(1e-6), radius=2, levels=8, quantised=quantised
        )
        np.testing.assert_allclose(found, 0.3, atol=1e-9)


def test_median_with_a_flat_guide_is_the_plain_median():
    rng = np.random.default_rng(2)
    values = np.where(rng.uniform(size=(30, 30)) < 0.2, 1.0, 0.0)
    guide = jnp.full((3, 30, 30), 0.5)
    found = weighted_median(jnp.asarray(values), guide, jnp.array(1e-4), radius=3, levels=16)
    # The guided filter averages twice, so its window is the triangle of two boxes.
    weight = ndimage.uniform_filter(ndimage.uniform_filter(values, 7), 7)
    sure = np.abs(weight - 0.5)[8:-8, 8:-8] > 0.1
    expected = (weight > 0.5)[8:-8, 8:-8]
    assert ((np.asarray(found)[8:-8, 8:-8] > 0.5) == expected)[sure].all()


def test_unknown_modes_are_named():
    blurred, guide, _ = blurred_step()
    with pytest.raises((ValueError, TypeError), match="bilateral"):
        sharpen(blurred, guide, MedianParams(), mode="bilateral")  # pyright: ignore[reportArgumentType]


def test_one_trace_serves_every_parameter():
    blurred, guide, _ = blurred_step()
    run, traces = count_traces(lambda p: sharpen(blurred, guide, p, radius=3, levels=8))
    wide = run(with_values(MedianParams, slack=0.2))
    tight = run(with_values(MedianParams, slack=0.01, epsilon=1e-5))
    assert traces() == 1
    assert float(jnp.abs(wide - tight).max()) > 0
