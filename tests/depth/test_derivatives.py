"""Every leaf of the parameters and the views: both modes against differences.

Leaves are walked by path: a new one is tested from its first day.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from depth.derivatives import check_rows, noisy_scene, rows, table
from helpers import check_modes

from mvedge_jax.depth import Parameters, Sizes, edge_to_depth
from mvedge_jax.edges import EdgeSizes
from mvedge_jax.edges.sides import BidirectionalParams, SurfaceParams
from mvedge_jax.lightfield import LightField

# Leaves that only select: which candidates are points. Their derivative is 0 almost everywhere, and
# rightly so.
THRESHOLDS = {
    "edges.strength_floor": "which pixels are candidates",
    "edges.error_limit": "which points are accepted",
}
# The same among those of the groups that are only read if given.
_GIVEN = {
    "bidirectional.offset": "which pixel a label is rounded to",
    "bidirectional.floor": "the least smoothness of the directional solves",
}


def _problem(name, size, *, given=False, dtype: type = np.float64, **choices):
    blind = noisy_scene(name, size, dtype=dtype)
    # Differences see what is left of the solver's error, derivatives do not.
    sizes = Sizes.for_light_field(blind, tolerance=1e-12, **choices)
    params = Parameters()
    if given:
        params = Parameters(bidirectional=BidirectionalParams(), surface=SurfaceParams())
    phase = jax.random.normal(jax.random.key(5), (size, size), dtype)

    def loss(tree):
        params, views = tree
        field = eqx.tree_at(lambda f: f.views, blind, views)
        found = edge_to_depth(field, params, sizes)
        return jnp.mean(jnp.sin(3 * found.disparity + phase))

    return loss, params, blind.views


def _check(name, size, zero, *, directions=2, **choices):
    check_rows(*_problem(name, size, **choices), zero, directions=directions)


SCENES = pytest.mark.parametrize("name", ["edges", "demo"])
CASES = [(name, side) for name in ("edges", "demo") for side in (40, 64, 96)]


@pytest.mark.parametrize(
    ("name", "side"),
    [CASES[0], *(pytest.param(*case, marks=pytest.mark.slow) for case in CASES[1:])],
)
def test_every_leaf_by_default(name, side):
    _check(name, side, set(THRESHOLDS))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "side"), CASES)
def test_every_leaf_of_the_optional_groups(name, side):
    _check(name, side, {*THRESHOLDS, *_GIVEN}, directions=1, given=True)


@pytest.mark.slow
@SCENES
def test_the_taps_of_the_filters_reach_the_map(name):
    """A random direction of each arm's taps. The filters' disparities only name them."""
    side = 40
    loss, params, views = _problem(name, side)
    sizes = EdgeSizes.for_light_field(LightField(views))

    def of_banks(tree):
        banks, views = tree
        edges = eqx.tree_at(lambda p: p.banks, params.edges, banks, is_leaf=lambda b: b is None)
        return loss((eqx.tree_at(lambda p: p.edges, params, edges), views))

    banks = sizes.banks(views.shape, views.dtype)
    found = rows(of_banks, banks, views, agree=3e-4, directions=0, key=jax.random.key(1))
    report = table(found)
    assert {r.name for r in found if r.zero} == {"[0].disparity", "[1].disparity"}, report
    assert max(r.error for r in found) < 1e-3, report


@pytest.mark.slow
@SCENES
def test_second_derivatives_of_the_chain(name):
    """Forward over reverse, and what `linearize` gives, along a direction of everything."""
    loss, params, views = _problem(name, 32, levels=12, median_radius=3)
    # In the logarithm of the parameters and in grey levels of the views: alike in size.
    logs = jax.tree.map(jnp.log, params)

    def value(tree):
        logs, change = tree
        return loss((jax.tree.map(jnp.exp, logs), views + change / 255))

    check_modes(value, (logs, jnp.zeros_like(views)), rtol=1e-3, step=1e-6, key=jax.random.key(2))


@pytest.mark.slow
@pytest.mark.parametrize(
    "scales",
    [
        (2.0**-33, 2.0**33, 2.0**66),
        pytest.param(
            (1e-20, 1e-10, 1e10, 1e20),
            marks=pytest.mark.xfail(
                reason="sums that cancel round otherwise: 1e-10 changes `median.epsilon` by 1.3e-4",
                strict=True,
            ),
        ),
    ],
    ids=["powers of two", "any"],
)
def test_the_chain_keeps_the_gradient_of_a_loss_of_any_size(scales):
    """In float32. A power of two changes no rounding, so what differs there has left the range."""
    loss, params, views = _problem("edges", 32, dtype=np.float32, levels=12, median_radius=3)

    @jax.jit
    def gradient(scale):
        return jax.grad(lambda tree: scale * loss(tree))((params, views))

    expected = gradient(jnp.float32(1))
    for scale in scales:
        found = gradient(jnp.float32(scale))
        pairs = zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True)
        for a, b in pairs:
            a = np.asarray(a, np.float64) / np.float64(np.float32(scale))
            b = np.asarray(b, np.float64)
            assert np.abs(a - b).max() <= 1e-5 * np.abs(b).max(), scale
