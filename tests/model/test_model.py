"""The rendered model: its derivatives, what points show and hide, and how it begins."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_modes, count_traces, lean

from mvedge_jax.depth import SplattedLabels
from mvedge_jax.diffusion import AutoSolver, Elimination
from mvedge_jax.losses import LossWeights, Views, self_supervised_loss
from mvedge_jax.model import DepthModel, Renderer, StartFit, render_model, start_from_image
from mvedge_jax.model._model import downsample, map_roughness, upsample
from mvedge_jax.model._start import Start, start_from_points
from mvedge_jax.model.objectives import SelfSupervised, Supervised, unlimited
from mvedge_jax.splatting import SplatLabels, SplatRaster, SplatWidths

SHAPE = (13, 16)
TARGET = jnp.asarray(np.random.default_rng(4).normal(size=SHAPE))
render = eqx.filter_jit(render_model)


def small_model(n=25, dtype: type = np.float64, seed=0):
    rng = np.random.default_rng(seed)
    return DepthModel(
        jnp.asarray(rng.uniform(-0.5, 1, n).astype(dtype)),
        jnp.asarray(rng.uniform(0, [SHAPE[1] - 1, SHAPE[0] - 1], (n, 2)).astype(dtype)),
        jnp.asarray((0.3 * rng.normal(size=n)).astype(dtype)),
        jnp.asarray(rng.uniform(0, 2, SHAPE).astype(dtype)),
        jnp.ones(n, bool),
    )


def exact(splat=None, **choices):
    """A solver whose own error is far below that of the differences."""
    splat = SplatLabels.thesis() if splat is None else splat
    return Renderer(splat, AutoSolver(tolerance=jnp.asarray(1e-13)), **choices)


def random_views(seed=1):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)

    def image(shift):
        return np.stack(
            [0.5 + 0.3 * np.sin(0.6 * x + shift + c) * np.cos(0.5 * y) for c in range(3)]
        )

    others = jnp.asarray(np.stack([image(0.3 * k) for k in range(3)]))
    steps = jnp.asarray(rng.normal(size=(3, 2)))
    return Views(jnp.asarray(image(0.0)), others, steps, jnp.ones(3, bool))


def test_gradient_of_the_whole_chain():
    """Splat at twice the size, diffuse, warp, loss: of Z, xy, R and Q, each on its own."""
    renderer = exact(SplatLabels(SplatWidths(), SplatRaster(scale=2, lanes=16)))
    model, views = small_model(), random_views()
    visible = jnp.asarray(np.random.default_rng(2).random((3, *SHAPE)) > 0.2)
    moving, fixed = eqx.partition(model, eqx.is_inexact_array)

    @lean
    def loss_and_gradient(tree):
        def loss(tree):
            disparity = render_model(eqx.combine(tree, fixed), renderer).disparity
            return self_supervised_loss(disparity, views, LossWeights(), visible=visible)[0]

        return jax.value_and_grad(loss)(tree)

    gradient = loss_and_gradient(moving)[1]
    for part in ("disparity", "xy", "log_weight", "roughness"):
        leaf = getattr(moving, part)
        direction = jax.random.normal(jax.random.key(3), leaf.shape)

        def along(t, part=part, leaf=leaf, direction=direction):
            moved = eqx.tree_at(lambda m: getattr(m, part), moving, leaf + t * direction)
            return float(loss_and_gradient(moved)[0])

        numeric = (along(1e-6) - along(-1e-6)) / 2e-6
        analytic = float(jnp.vdot(getattr(gradient, part), direction))
        assert analytic == pytest.approx(numeric, rel=1e-5), part


@pytest.mark.slow
def test_both_modes_and_the_second_derivative():
    """Of the rendered map, with respect to points and parameters."""
    solver = Elimination(tolerance=1e-13)
    renderer = jax.tree.map(jnp.asarray, exact().replace(solver=solver))
    still, turning = eqx.partition(renderer, lambda leaf: leaf is renderer.solver.tolerance)

    def loss(tree):
        model, turning = tree
        return jnp.sum(jnp.sin(render_model(model, eqx.combine(still, turning)).disparity - TARGET))

    check_modes(loss, (small_model(), turning), rtol=1e-5, key=jax.random.key(6))


@pytest.mark.parametrize("kind", [pytest.param(Supervised, marks=pytest.mark.slow), SelfSupervised])
def test_both_modes_and_the_second_derivative_of_the_objectives(kind):
    model, key = small_model(), jax.random.key(8)
    objective = {
        Supervised: lambda *rest: Supervised(TARGET, jnp.ones(SHAPE, bool), *rest),
        SelfSupervised: lambda *rest: SelfSupervised(random_views(), *rest),
    }[kind](unlimited(model), exact())

    def loss(model):
        return objective(model, jnp.zeros(SHAPE), key=key)[0]

    check_modes(loss, model, rtol=1e-3, step=1e-7, key=jax.random.key(7))


def test_a_plane_of_equal_labels_is_reproduced_and_a_mask_ignored():
    model = small_model()
    flat = eqx.tree_at(lambda m: m.disparity, model, jnp.full(25, 0.7))
    np.testing.assert_allclose(render(flat, exact()).disparity, 0.7, atol=1e-9)
    masked = DepthModel(
        model.disparity.at[3].set(jnp.nan), model.xy.at[4].set(jnp.nan), model.log_weight,
        model.roughness, model.valid.at[jnp.array([3, 4])].set(False),
    )  # fmt: skip
    clean = eqx.tree_at(lambda m: m.valid, model, masked.valid)
    a, b = (render(m, exact()).disparity for m in (masked, clean))
    np.testing.assert_array_equal(a, b)


@pytest.mark.slow
def test_unnormalised_labels_fade_beside_points():
    place = (jnp.array([[8.0, 6.0]]), jnp.ones(1))
    model = eqx.tree_at(lambda m: (m.xy, m.disparity), small_model(n=1), place)
    np.testing.assert_allclose(render(model, exact()).disparity, 1, atol=1e-9)
    faded = render(model, exact(normalized=False)).disparity
    assert 1e-6 < float(1 - faded.mean()) < 1e-2


@pytest.mark.parametrize("scale", [1, 2])
def test_narrow_points_leave_the_pixel_beside_them_to_others(scale):
    """Most of it, at any scale; a point of the thesis' width takes it over entirely."""
    xy = jnp.array([[5.0, 6.0], [6.0, 6.0], [1.0, 1.0]])
    model = DepthModel(
        jnp.array([1.0, 0.0, 0.0]), xy, jnp.zeros(3), jnp.full(SHAPE, 8.0), jnp.ones(3, bool)
    )
    raster = SplatRaster(scale=scale, lanes=16)
    narrow = SplatLabels(SplatLabels.on_raster(scale).widths, raster)
    narrow = render(model, Renderer(narrow)).disparity
    assert float(narrow[6, 5]) > 0.9
    assert float(narrow[6, 6]) < 0.5
    label, weight = jnp.asarray(0.65 * scale), jnp.asarray(0.35 * scale)
    thesis = SplatLabels(SplatWidths(sigma_label=label, sigma_weight=weight), raster)
    assert float(render(model, Renderer(thesis)).disparity[6, 6]) > 0.9


def test_no_points_at_all_render_to_zero_with_finite_gradients():
    model = eqx.tree_at(lambda m: m.valid, small_model(), jnp.zeros(25, bool))

    def total(tree):
        return jnp.sum(render_model(eqx.combine(tree, model), exact()).disparity)

    value, gradient = lean(jax.value_and_grad(total))(eqx.filter(model, eqx.is_inexact_array))
    assert float(value) == 0
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(gradient))


@pytest.mark.parametrize("scale", [1, 2])
def test_points_of_a_model_are_splatted_as_those_of_the_chain(scale):
    """`SplattedLabels` calls the same `SplatLabels`, in image pixels."""
    model, labels = small_model(), SplatLabels.on_raster(scale)
    opaque = Renderer(labels, clears=False)
    found = render(model, opaque).splat
    weight = jnp.exp(-model.log_weight)
    expected = SplattedLabels(labels).splat(model.xy, model.disparity, weight, model.valid, SHAPE)
    np.testing.assert_array_equal(found.weight, expected.weight)
    np.testing.assert_array_equal(found.label, expected.label)


def test_resampling_is_aligned_and_adjoint_to_averaging():
    ramp = jnp.broadcast_to(jnp.arange(7.0)[None], (5, 7))
    up = upsample(ramp, 2)
    assert up.shape == (10, 14)
    np.testing.assert_allclose(up[0, 1:-1], (np.arange(1, 13) + 0.5) / 2 - 0.5, atol=2e-5)
    np.testing.assert_allclose(downsample(up, 2)[:, 1:-1], ramp[:, 1:-1], atol=2e-5)


def test_initial_roughness_follows_edges():
    image = jnp.zeros((6, 8, 3)).at[:, 4:].set(1.0)
    flat = Start(small_model(), jnp.ones(25), jnp.zeros((6, 8)))
    rough = start_from_image(flat, image).model.roughness
    np.testing.assert_allclose(rough[:, 3:5], 15.0, atol=0.1)
    np.testing.assert_allclose(rough[:, :3], 0, atol=1e-6)
    step = jnp.zeros((6, 8)).at[:, 4:].set(0.5)
    both = map_roughness(step, image)
    assert float(both[:, 4].min()) == 10.0
    assert float(jnp.delete(both, 4, axis=1).max()) < 1e-6
    # a colour edge alone is no reason to cut
    assert float(map_roughness(jnp.zeros((6, 8)), image).max()) < 1e-6


def test_one_trace_and_float32():
    traced, traces = count_traces(lambda m, r: render_model(m, r).disparity)
    model = small_model(dtype=np.float32)
    first = traced(model, Renderer.thesis())
    traced(eqx.tree_at(lambda m: m.disparity, model, model.disparity + 1), Renderer.thesis())
    assert traces() == 1
    assert first.dtype == jnp.float32
    wide = render(small_model(), exact()).disparity
    assert float(jnp.abs(first.astype(float) - wide).max()) < 1e-3


def test_points_that_are_cut_off_are_refused():
    narrow = Renderer.on_raster(1)
    assert "splat.widths.sigma_label = 0.35 raster px" in str(narrow)
    assert Renderer.on_raster(2).splat.widths.sigma_label == 0.7
    assert Renderer.thesis().splat.widths.sigma_label == 1.3
    with pytest.raises(ValueError, match=r"sigma_label` = 1\.3 px .*radius` = 2 px"):
        narrow.replace({"splat.widths": SplatWidths()})
    with pytest.raises(ValueError, match=r"sigma_label` = 0\.7 px .*radius` = 1 px"):
        SplatLabels(SplatLabels.on_raster(2).widths, SplatRaster(scale=2, radius=1))
    # Of several settings, the widest counts.
    with pytest.raises(ValueError, match=r"sigma_weight` = 3 px .*radius` = 2 px"):
        narrow.replace({"splat.widths.sigma_weight": jnp.asarray([0.4, 3.0])})
    with pytest.raises(ValueError, match="`splat.width` is no path of `Renderer`"):
        narrow.replace({"splat.width": 1.0})


def test_a_point_outside_of_the_image_takes_no_part():
    xy = jnp.array([[3.0, 4.0], [-0.7, 2.0]])
    start = start_from_points(
        xy, jnp.ones(2), jnp.full(2, 0.01), jnp.ones(2, bool), jnp.full((*SHAPE, 3), 0.5),
        jnp.zeros(SHAPE), StartFit(),
    )  # fmt: skip
    assert start.model.valid.tolist() == [True, False]
