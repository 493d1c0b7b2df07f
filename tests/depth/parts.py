"""What a part has to keep, whoever wrote it: `check_part` is the template, inputs are tiny."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from helpers import lean

from mvedge_jax._crosshair import crosshair
from mvedge_jax._params import cast
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.edges import EdgePoints
from mvedge_jax.edges.sides import Sides, SurfaceVectors
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import CalibratedViews, Evidence
from mvedge_jax.photometry.brightness import Exposure, Noise
from mvedge_jax.photometry.matching import Hypotheses
from mvedge_jax.photometry.measuring import PhotometricLabels

SHAPE, COUNT = (12, 14), 24


class Given(NamedTuple):
    """What the parts read: a card before a wall, and points in it, a third of them empty slots."""

    points: EdgePoints
    evidence: Evidence
    sides: Sides
    guide: jax.Array
    disparity: jax.Array
    depth_edge: jax.Array
    precision: jax.Array


def given(seed: int = 0) -> Given:
    """Random points and views in float64."""
    rng = np.random.default_rng(seed)
    height, width = SHAPE
    near = np.where(np.arange(width) < width // 2, 0.0, 1.0) * np.ones(SHAPE)
    views = rng.uniform(0.1, 0.9, (3, 3, *SHAPE, 3))
    field = LightField(jnp.asarray(views))
    guide = jnp.moveaxis(field.center_view, -1, 0)
    lab = jnp.moveaxis(srgb_to_lab(field.center_view), -1, 0)
    map_ = jnp.asarray(near + 0.05 * rng.normal(size=SHAPE))
    one = jnp.ones(())
    exposure, noise = Exposure(one, jnp.ones((3, 3))), Noise.of(0.01 * one)
    hypotheses = Hypotheses(map_, map_, 0 * map_)
    calibrated = CalibratedViews(crosshair(field), exposure, noise, guide, lab, hypotheses)
    variance = jnp.asarray(rng.uniform(1e-4, 1e-2, SHAPE))
    evidence = Evidence(calibrated, None, PhotometricLabels(map_, variance, variance))

    angle = rng.uniform(0, 2 * np.pi, COUNT)
    xy = rng.uniform([0.6, 0.6], [width - 1.6, height - 1.6], (COUNT, 2))
    valid = np.arange(COUNT) % 3 != 2

    def only(values: np.ndarray) -> jax.Array:
        return jnp.asarray(np.where(valid.reshape(-1, *[1] * (values.ndim - 1)), values, 0))

    points = EdgePoints(
        xy=only(xy),
        disparity=only(
            near[tuple(np.rint(xy).astype(int).T[::-1])] + 0.02 * rng.normal(size=COUNT)
        ),
        confidence=only(rng.uniform(0.2, 0.8, COUNT)),
        error=only(rng.uniform(0.002, 0.02, COUNT)),
        normal=only(np.stack([np.cos(angle), np.sin(angle)], -1)),
        visible=only(np.ones((COUNT, 6), bool)).astype(bool),
        valid=jnp.asarray(valid),
    )
    score = only(rng.normal(size=COUNT))
    offset = jnp.sign(score)[:, None] * points.normal
    surface = SurfaceVectors(score, jnp.where(valid, jax.nn.sigmoid(score), 0.5), offset, one)
    edge = jnp.asarray(rng.uniform(0, 0.2, SHAPE))
    confidence = only(rng.uniform(0, 1, COUNT))
    sides = Sides(surface, confidence, edge, map_, jnp.zeros(2, jnp.int32))
    return Given(points, evidence, sides, lab, map_, edge, jnp.asarray(0.005))


def with_junk(of: Given) -> Given:
    """The same with other numbers in the empty slots."""
    empty = ~np.asarray(of.points.valid)

    def spoil(leaf: jax.Array) -> jax.Array:
        if leaf.shape[:1] != (COUNT,) or leaf.dtype == bool:
            return leaf
        return jnp.where(empty.reshape(-1, *[1] * (leaf.ndim - 1)), 3.3, leaf)

    return of._replace(points=jax.tree.map(spoil, of.points))


def _total(tree: Any) -> jax.Array:
    """A sum in which every entry has a weight of its own."""
    total = jnp.zeros(())
    for index, leaf in enumerate(jax.tree.leaves(tree)):
        if eqx.is_inexact_array(leaf):
            weight = jnp.cos(index + jnp.arange(leaf.size, dtype=leaf.dtype)).reshape(leaf.shape)
            total = total + jnp.sum(weight * leaf).astype(total.dtype)
    return total


def _close(found: Any, wanted: Any, **tolerance: Any) -> None:
    pairs = zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True)
    for a, b in pairs:
        np.testing.assert_allclose(a, b, **tolerance)


def check_part(
    part: Any, call: Callable[[Any, Given], Any], *, rtol: float = 1e-9, atol: float = 1e-12
) -> Any:
    """Checks all that a part of the chain has to keep, and returns what it gave.

    Args:
        part: a module.
        call: how the chain calls it.
        rtol, atol: how far results of the same numbers may differ, as where a solver stops.
    """
    of = given()
    moving, rest = eqx.partition((part, of), eqx.is_inexact_array)

    def run(moving: Any, rest: Any = rest) -> Any:
        return call(*eqx.combine(moving, rest))

    # Values and derivatives of one program, for several inputs of one shape.
    both = lean(lambda m: (run(m), jax.grad(lambda m: _total(run(m)))(m)))
    found, gradient = both(moving)
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves((found, gradient)))

    with jax.disable_jit(False):
        _close(run(moving), found, rtol=rtol, atol=atol)

    spoilt = eqx.filter((part, with_junk(of)), eqx.is_inexact_array)
    other, elsewhere = both(spoilt)
    _close(other, found, rtol=0, atol=0)
    empty = ~np.asarray(of.points.valid)
    for _, by_points in (gradient, elsewhere):
        for leaf in jax.tree.leaves(by_points.points):
            assert not np.asarray(leaf)[empty].any()
    _close(gradient[0], elsewhere[0], rtol=rtol, atol=atol)

    single = jax.eval_shape(run, cast(moving, jnp.float32))
    for leaf in jax.tree.leaves(single):
        assert leaf.dtype in (jnp.float32, jnp.int32, bool), leaf
    # Parameters never promote: they follow the data.
    mixed = jax.eval_shape(run, (moving[0], cast(moving[1], jnp.float32)))
    assert jax.tree.map(lambda s: s.dtype, mixed) == jax.tree.map(lambda s: s.dtype, single)

    second = eqx.filter((part, given(1)), eqx.is_inexact_array)
    stacked = jax.tree.map(lambda a, b: jnp.stack([a, b]), moving, second)
    together = lean(jax.vmap(run))(stacked)
    for index, alone in enumerate((moving, second)):
        one = jax.tree.map(lambda leaf, index=index: leaf[index], together)
        _close(one, both(alone)[0], rtol=rtol, atol=atol)
    return found
