"""The rendered model: its derivatives, what points show and hide, and how it begins."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, check_modes, count_traces, lean
from photometry.scenes import plane_views

from mvedge_jax.diffusion import AutoSolver, Elimination
from mvedge_jax.losses import LossWeights, gather_views, self_supervised_loss
from mvedge_jax.model import DepthModel, Renderer, StartFit, render_model, start_from_image
from mvedge_jax.model._model import map_roughness
from mvedge_jax.model._start import Start, start_from_points
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


def test_gradient_of_the_whole_chain():
    """Splat at twice the size, diffuse, warp, loss: of Z, xy, R and Q."""
    renderer = exact(SplatLabels(SplatWidths(), SplatRaster(scale=2, lanes=16)))
    model = small_model()
    views = gather_views(plane_views(0.3, views=(3, 3), size=SHAPE))
    visible = jnp.asarray(np.random.default_rng(2).random((4, *SHAPE)) > 0.2)

    def loss(model):
        disparity = render_model(model, renderer).disparity
        return self_supervised_loss(disparity, views, LossWeights(), visible=visible)[0]

    check_gradient(loss, model, rtol=1e-5, step=1e-6, key=jax.random.key(3))


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


def test_no_points_at_all_render_to_zero_with_finite_gradients():
    model = eqx.tree_at(lambda m: m.valid, small_model(), jnp.zeros(25, bool))

    def total(tree):
        return jnp.sum(render_model(eqx.combine(tree, model), exact()).disparity)

    value, gradient = lean(jax.value_and_grad(total))(eqx.filter(model, eqx.is_inexact_array))
    assert float(value) == 0
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(gradient))


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
    # a color edge alone is no reason to cut
    assert float(map_roughness(jnp.zeros((6, 8)), image).max()) < 1e-6


def test_one_trace_and_float32():
    traced, traces = count_traces(lambda m, r: render_model(m, r).disparity)
    model = small_model(dtype=np.float32)
    first = traced(model, Renderer(SplatLabels.thesis()))
    traced(
        eqx.tree_at(lambda m: m.disparity, model, model.disparity + 1),
        Renderer(SplatLabels.thesis()),
    )
    assert traces() == 1
    assert first.dtype == jnp.float32
    wide = render(small_model(), exact()).disparity
    assert float(jnp.abs(first.astype(float) - wide).max()) < 1e-3


def test_points_that_are_cut_off_are_refused():
    narrow = Renderer.on_raster(1)
    assert "splat.widths.sigma_label = 0.35 raster px" in str(narrow)
    assert Renderer.on_raster(2).splat.widths.sigma_label == 0.7
    assert Renderer(SplatLabels.thesis()).splat.widths.sigma_label == 1.3
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
