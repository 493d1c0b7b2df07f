"""Every leaf of the parameters and the views: both modes against differences, by default and not.

Leaves are walked by path: a new one is tested from its first day.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from centre.derivatives import rows, table
from helpers import check_modes

from mvedge_jax.centre import Parameters, Sizes, edge_to_depth
from mvedge_jax.datasets import synthetic
from mvedge_jax.edges import BidirectionalParams, EdgeSizes, SurfaceParams
from mvedge_jax.epi import ThesisParams, ThesisSteps
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import PhotometricParams, VolumeParams


@pytest.fixture(autouse=True)
def _optimised():
    """Hundreds of values are computed here: programs that run fast pay off."""
    before = jax.config.values["jax_disable_most_optimizations"]
    jax.config.update("jax_disable_most_optimizations", False)
    yield
    jax.config.update("jax_disable_most_optimizations", before)


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
# The choice of one side per edge, with `relaxed=False`: weights of what it is made from.
_SIDED = {
    "surface.offset",
    "surface.response",
    "surface.neighbours",
    "surface.dense",
    "surface.radius",
    "surface.cap",
    "surface.temperature",
}
# What the map needs no more when only points are diffused.
_DENSE = {"surface.dense", "centre.points", "centre.trust", "centre.slant"}


def _problem(name, size, *, edges=None, given=False, dtype: type = np.float64, **choices):
    light_field = synthetic.render(
        synthetic.scene(name), shape=(5, 5, size, size), samples=2, key=jax.random.key(0)
    )
    blind = light_field.without_truth()
    views = blind.views.astype(dtype)
    # A quarter of a grey level of noise: in a clean image both pixels beside an edge have the very
    # same contrast, and any change of the views, however small, chooses another one.
    views = views + 1e-3 * jax.random.normal(jax.random.key(4), views.shape, dtype)
    blind = eqx.tree_at(lambda f: f.views, blind, views)
    # Differences see what is left of the solver's error, derivatives do not.
    sizes = Sizes.for_light_field(blind, tolerance=1e-12, **choices)
    params = Parameters()
    if given:
        params = Parameters(bidirectional=BidirectionalParams(), surface=SurfaceParams())
    if edges is not None:
        sizes = dataclasses.replace(sizes, edges=dataclasses.replace(sizes.edges, thesis=edges))
        params = eqx.tree_at(
            lambda p: p.edges.thesis, params, ThesisParams(), is_leaf=lambda leaf: leaf is None
        )
    phase = jax.random.normal(jax.random.key(5), (size, size), dtype)

    def loss(tree):
        params, views = tree
        field = eqx.tree_at(lambda f: f.views, blind, views)
        found = edge_to_depth(params, field, sizes, key=jax.random.key(3))
        return jnp.mean(jnp.sin(3 * found.disparity + phase))

    return loss, params, blind.views


def _check(name, size, zero, *, directions=2, **choices):
    """Right to 1e-3 in both modes, or exactly zero and known to be; a kink is told from an error.

    At a kink the derivative may be that of either side, or lie between them.
    """
    loss, params, views = _problem(name, size, **choices)
    found = rows(loss, params, views, agree=3e-4, directions=directions, key=jax.random.key(1))
    report = table(found)
    print(report)  # noqa: T201 (`pytest -s` shows the table)
    wrong = [r.name for r in found if r.error > 1e-3 and not (r.kink > 1e-2 and r.between)]
    assert not wrong, f"{wrong}\n{report}"
    kinks = [r.name for r in found if r.error > 1e-3]
    assert all(k.startswith("views") for k in kinks), f"{kinks}\n{report}"
    assert {r.name for r in found if r.zero} == set(zero), report


SCENES = pytest.mark.parametrize("name", ["edges", "demo"])
SIDES = pytest.mark.parametrize(
    "side", [40, *(pytest.param(side, marks=pytest.mark.slow) for side in (64, 96))]
)
# The thesis' points have none of ours, and which of its lines are points is a choice, too.
_OURS = {
    *(f"volume.{name}" for name in vars(VolumeParams())),
    *(f"photometric.{name}" for name in vars(PhotometricParams())),
    "edges.thesis.smoothing",
    "edges.thesis.suppression",
    "edges.thesis.vote",
}
_ALWAYS = {*THRESHOLDS, *_GIVEN}
_POINTS = _ALWAYS | _DENSE | {"surface.offset"}
_CHOSEN = _POINTS | _SIDED
# What only points alone are weighted by, and what a score is made from.
_UNREAD = {f"bidirectional.{name}" for name in ("gain", "limit", "data", "gradient")}
MODES = {
    "points only": ({"dense": False}, _CHOSEN),
    "points on both sides": ({"dense": False, "relaxed": True}, _POINTS),
    "one side": ({"relaxed": False}, _ALWAYS | _SIDED | _UNREAD),
    "thesis": (
        {"dense": False, "side": "thesis", "edges": ThesisSteps()},
        _CHOSEN | _OURS,
    ),
}


@SCENES
@SIDES
def test_every_leaf_by_default(name, side):
    _check(name, side, set(THRESHOLDS))


@pytest.mark.parametrize(
    ("mode", "name", "side"),
    [
        # The gradient of a whole chain takes minutes to compile: the fast tier has one of these.
        pytest.param(mode, name, side, marks=[] if fast else [pytest.mark.slow])
        for mode in MODES
        for name in ("edges", "demo")
        for side in (40, 64, 96)
        for fast in [mode == "points only" and name == "edges" and side == 40]
    ],
)
def test_every_leaf_in_other_modes(mode, name, side):
    choices, zero = MODES[mode]
    _check(name, side, zero, directions=1, given=True, **choices)


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
