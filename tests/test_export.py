"""Programs that take and return the package's types go to a file and come back."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export

import mvedge_jax as mv
from mvedge_jax import _export
from mvedge_jax.depth import DepthStats, SplattedLabels
from mvedge_jax.edges import EdgeStats
from mvedge_jax.edges.sides import SurfaceVectors
from mvedge_jax.photometry.brightness import Exposure, Noise
from mvedge_jax.smoothness import ColorAndDepth
from mvedge_jax.splatting import SplatLabels, SplatRaster
from mvedge_jax.superpixels import Superpixels

pytest.importorskip("flatbuffers", reason="jax.export writes files by it")


def result(light_field, rule):
    """A `DepthResult` of nothing but sums: the chain would take a minute to compile."""
    flat = light_field.views[1, 1, :, :, 0] * rule.color
    one, count, yes = flat[0, 0], jnp.asarray(3), jnp.asarray(True)
    column, pair = flat[:4, 0], flat[:4, :2]
    points = mv.EdgePoints(pair, column, column, column, pair, pair > 0, column > 0)
    surface = SurfaceVectors(*(column for _ in SurfaceVectors._fields))
    noise, exposure = Noise(one, one, one), Exposure(one, flat[:3, :3])
    edges = EdgeStats(count, count, count, count)
    steps = jnp.asarray([1, 2])
    stats = DepthStats(edges, count, count, steps, yes, noise, exposure, yes, flat[0, :2])
    return mv.DepthResult(flat, flat, flat, points, surface, stats)


def test_a_depth_result_goes_to_a_file_and_back():
    views = jnp.asarray(np.random.default_rng(0).random((3, 3, 6, 8, 3)))
    truth = mv.GroundTruth(views[0, 0, :, :, 0], views[0, 0, :, :, 0] > 0.5)
    places = np.stack(np.meshgrid([-1, 0, 1.4], [-1, 0, 1]), axis=-1)
    known = {"disparity_range": (-1.0, 1.0), "truth": truth, "positions": places}
    light_field = mv.LightField(views, name="a scene", **known)
    data = export.export(jax.jit(result))(light_field, ColorAndDepth()).serialize(vjp_order=1)
    program = export.deserialize(data)
    found = program.call(light_field, ColorAndDepth())
    assert type(found) is mv.DepthResult
    wanted = result(light_field, ColorAndDepth())
    assert jax.tree.structure(found) == jax.tree.structure(wanted)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)
    call: Any = program.call
    slope = jax.grad(lambda p: call(light_field, p).disparity.sum())(ColorAndDepth())
    assert float(slope.color) == pytest.approx(float(views[1, 1, :, :, 0].sum()))
    with pytest.raises(ValueError, match="a scene"):
        program.call(light_field.renamed("another"), ColorAndDepth())


@pytest.mark.parametrize(
    "part",
    [
        SplattedLabels(splat=SplatLabels(raster=SplatRaster(scale=2, capacity=7))),
        mv.diffusion.Multigrid(max_iterations=7),
    ],
    ids=["labels", "solver"],
)
def test_static_choices_are_kept(part):
    data = export.export(jax.jit(lambda part: part))(part).serialize()
    assert jax.tree.structure(export.deserialize(data).call(part)) == jax.tree.structure(part)


def test_every_public_type_is_registered():
    for kind in (mv.LightField, ColorAndDepth, mv.ViewDepths, mv.System, mv.Optimized, Superpixels):
        assert kind in _export._registered


def test_a_static_field_that_is_no_plain_value_is_named():
    assert _export._restored(_export._plain("x", (1, ("a", None)))) == (1, ("a", None))

    class Holder(eqx.Module):
        leaf: jax.Array
        rule: object = eqx.field(static=True)

    _export._register_module(Holder, "test.Holder")
    exported = export.export(jax.jit(lambda h: h.leaf))(Holder(jnp.ones(2), jnp.sin))
    with pytest.raises(TypeError, match=r"hold `test.Holder.rule` = .* cannot be serialized"):
        exported.serialize()
