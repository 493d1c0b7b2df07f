"""Traced hyperparameters."""

import jax
import jax.numpy as jnp

from mvedge_jax._params import cast
from mvedge_jax.depth import DepthStats
from mvedge_jax.diffusion import SolveStats
from mvedge_jax.edges import EdgeStats
from mvedge_jax.photometry.brightness import Exposure, Noise
from mvedge_jax.posed import StereoStats
from mvedge_jax.smoothness import ColorAndDepth


def test_a_cast_has_a_derivative_in_the_precision_of_the_number():
    part = ColorAndDepth()
    assert cast(part, jnp.float32).color.dtype == jnp.float32
    slope = jax.grad(lambda p: cast(p, jnp.float32).color)(part).color
    assert (slope, slope.dtype) == (1, part.color.dtype)


def test_statistics_print_their_numbers():
    solve = SolveStats(*map(jnp.asarray, (12, 1.5e-6, 0.25, True, 0)))
    assert repr(solve) == (
        "SolveStats(iterations=12, residual=1.5e-06, estimate=0.25, converged=True, isolated=0)"
    )
    noise = Noise(*jnp.asarray([0.004, 0.5, 0.001]))
    exposure = Exposure(jnp.asarray(1.0), jnp.ones((9, 9)))
    edges = EdgeStats(*map(jnp.asarray, (5, 0, 4, 3)))
    two, yes, steps = jnp.asarray(2), jnp.asarray(True), jnp.asarray([7, 9])
    searched = jnp.asarray([-1.0, 1.0])
    depth = DepthStats(edges, two, two, steps, yes, noise, exposure, yes, searched)
    shown = [str(depth)]
    for text in (
        "edges=EdgeStats(candidates=5, overflow=0, consistent=4, valid=3)",
        "iterations=[7, 9], converged=True, noise=Noise(deviation=0.004, alpha=0.5",
        "gain=f64[9,9]",
    ):
        assert text in shown[0]
    stereo = StereoStats(steps, ~yes, noise, searched, searched, exposure.scale)
    assert "converged=False, noise=Noise(deviation=0.004" in repr(stereo)
    jax.eval_shape(lambda stats: shown.append(repr(stats)), edges)
    assert shown[1].startswith("EdgeStats(candidates=")
    assert "i64[]" in shown[1]
