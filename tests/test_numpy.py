"""NumPy's float64 is taken without a warning of JAX where `jax_enable_x64` is off."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mvedge_jax as mv
from mvedge_jax import (
    color,
    diffusion,
    edges,
    edit,
    epi,
    image,
    interpolation,
    losses,
    metrics,
    model,
    splatting,
    warping,
)
from mvedge_jax.depth import Sharpen
from mvedge_jax.depth._median import weighted_median
from mvedge_jax.edges import sides
from mvedge_jax.edges.thesis import joint_filter
from mvedge_jax.losses import terms
from mvedge_jax.metrics import depth as scores
from mvedge_jax.posed import cloud, projections
from mvedge_jax.posed.scores import depth_errors
from mvedge_jax.smoothness import ColorAndDepth, edge_smoothness

Y, X = 12, 14
_RNG = np.random.default_rng(0)


def some(*shape: int) -> Any:  # Array, to a type checker
    return _RNG.uniform(0.1, 0.9, shape)


MAP, MASK, RGB, PLANES = some(Y, X), some(Y, X) > 0.4, some(Y, X, 3), some(3, Y, X)
VIEWS, MAPS, ARM = some(3, 3, Y, X, 3), some(3, 3, Y, X), some(3, X)


def eye(n: int) -> Any:
    return np.eye(n)


ONE: Any = np.float64(1)
STEP: Any = np.array([1.0, 0.0])
VALID: Any = np.ones(5, bool)
XY, LABEL = 1 + 9 * some(5, 2), some(5)
RASTER, POINTS = ((Y, X), splatting.SplatRaster()), (XY, LABEL, LABEL, VALID)


def light_field():
    truth = mv.GroundTruth(MAP, MASK)
    return mv.LightField(VIEWS, disparity_range=np.array([-1.0, 1.0]), truth=truth)


def system(weight=MAP):
    return diffusion.System(weight, MAP, some(Y, X - 1), some(Y - 1, X))


def others():
    return losses.Views(PLANES, some(2, 3, Y, X), np.eye(2), np.ones(2, bool))


def points():
    normal, visible = np.tile(STEP, (5, 1)), np.ones((5, 6), bool)
    return mv.EdgePoints(XY, LABEL, LABEL, LABEL, normal, visible, VALID)


def lines():
    return epi.fit_lines(ARM, ARM, ONE, capacity=8)


def rendered():
    points = model.DepthModel(LABEL, XY, LABEL, MAP, VALID)
    return model.render_model(points, model.Renderer.on_raster(1))


def camera():
    return mv.Camera(np.float64(100), np.array(0.1), np.float64(2))


CALLS = {
    "light field": lambda: (light_field().downsample(2), light_field().crop_views(1)),
    "camera": lambda: (camera().depth(MAP), camera().disparity(MAP), camera().downsample(2)),
    "system": lambda: (system().matvec(MAP), system().right_hand_side(), system().energy(MAP)),
    "diffuse": lambda: (diffusion.diffuse(system()), diffusion.diffuse(system(MASK), start=MAP)),
    "edge weights": lambda: diffusion.edge_weights(MAP),
    "filter": lambda: joint_filter(XY, LABEL, VALID, RGB, ONE, ONE, ONE),
    "smoothness": lambda: edge_smoothness(PLANES, MAP, ColorAndDepth()),
    "sharpen": lambda: Sharpen(radius=2, levels=8)(MAP, PLANES),
    "median": lambda: weighted_median(MAP, PLANES, ONE, radius=2, levels=8),
    "color": lambda: (color.srgb_to_lab(RGB), color.srgb_to_gray(RGB), color.planes_to_lab(PLANES)),
    "raster": lambda: edges.rasterize(XY, LABEL, VALID, (Y, X)),
    "share": lambda: edges.share(XY, LABEL, LABEL, MAP, ONE),
    "sides": lambda: sides.surface_vectors(points(), None, MAP, sides.SideVote(), shape=(Y, X)),
    "paint": lambda: edit.paint(light_field(), MAPS, MAP, some(3)),
    "epi": lambda: epi.epi_edge_map(some(3, X, 3), epi.prewitt_bank(2 * some(2) - 1, 3, 2)),
    "lines": lambda: epi.merge_scales(lines()[0], lines()[0], ONE, views=3),
    "image": lambda: (image.box_mean(MAP, 1), image.gaussian(MAP, ONE, radius=2)),
    "gradient": lambda: (image.unit_gradient(MAP), image.convolved(MAP, some(3), axis=0)),
    "sample": lambda: (interpolation.sample(MAP, XY), interpolation.cubic_taps(MAP)),
    "self-supervised": lambda: losses.self_supervised_loss(MAP, others(), losses.LossWeights()),
    "supervised": lambda: losses.supervised_loss(
        MAP, MAP, MASK, losses.SupervisedWeights(ONE, ONE[None][0])
    ),
    "terms": lambda: (terms.edge_aware_smoothness(MAP, PLANES), terms.ssim(PLANES, PLANES)),
    "scores": lambda: metrics.depth_scores(MAP, MAP, mask=MASK, edge_threshold=ONE),
    "bad pixels": lambda: (
        scores.bad_pixels(MAP, MAP, ONE),
        scores.error_percentile(MAP, MAP, ONE),
    ),
    "boundary": lambda: metrics.boundary_scores(MAP, MAP, thresholds=some(2)),
    "consistency": lambda: metrics.view_consistency(MAPS, tolerance=ONE),
    "render": rendered,
    "posed": lambda: projections(eye(4)[None], eye(3)[None], 0, ONE),
    "cloud": lambda: cloud.surface_of(MAP, eye(4), eye(3)),
    "depth errors": lambda: depth_errors(MAP, MAP),
    "splat": lambda: splatting.splat(*POINTS, splatting.SplatWidths(ONE), *RASTER),
    "backward": lambda: (
        warping.backward_warp(RGB, MAP, STEP),
        warping.warp_planes(PLANES, MAP, STEP),
    ),
    "forward": lambda: (warping.forward_warp(RGB, MAP, STEP), warping.holes(MAP, MASK)),
    "outline": lambda: warping.outline(MAP, PLANES, 0.01 * ONE, warping.Outline()),
    "visible": lambda: (warping.visible(MAP, STEP), warping.visible_binned(MAP, STEP)),
}


@pytest.mark.parametrize("name", CALLS)
def test_float64_of_numpy_gives_no_warning(name):
    """Arrays are taken at the boundary: to trace what is behind it shows as much as to run it."""
    with jax.enable_x64(False):
        # Segments are matched on the host.
        found = CALLS[name]() if name == "segments" else jax.eval_shape(CALLS[name])
    leaves = jax.tree.leaves(found)
    assert not [leaf for leaf in leaves if getattr(leaf, "dtype", None) == jnp.float64]


def test_a_boolean_mask_is_a_weight():
    """In the precision of the labels, whatever the default is."""
    edge = jnp.ones((1, 3), jnp.float32), jnp.ones((0, 4), jnp.float32)
    label = jnp.asarray([[0.0, 9.0, 9.0, 3.0]], jnp.float32)
    mask = jnp.asarray([[True, False, False, True]])
    for given in (mask, np.asarray(mask)):
        masked = diffusion.System(given, label, *edge)
        assert masked.weight.dtype == jnp.float32
        found = diffusion.diffuse(masked).value
        plain = diffusion.System(mask.astype(jnp.float32), label, *edge)
        np.testing.assert_array_equal(found, diffusion.diffuse(plain).value)
    in_jit = jax.jit(lambda m: diffusion.diffuse(diffusion.System(m, label, *edge)).value)(mask)
    np.testing.assert_allclose(in_jit, found, atol=1e-6)
