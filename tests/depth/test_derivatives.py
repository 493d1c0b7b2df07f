"""Every leaf of the model and the views: both modes against differences.

Leaves are walked by path, so that a new one is tested from its first day. Those that `describe`
marks as thresholds have the derivative 0, and no others but those that a preset does not read, and
in some scenes those that only bound something.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from depth.derivatives import check_rows, noisy_scene, rows
from helpers import check_modes

from mvedge_jax import describe
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.edges import OrientedEdges

# Of the parts of a preset, what it does not read.
UNREAD = {
    # That is for labels of all views.
    "full": {"refine.parted", "sides.vote.response"},
    "edges": {
        *(f"sides.vote.{n}" for n in ("response", "neighbors", "dense", "radius", "cap")),
        "sides.vote.temperature",
        "edges.half_confidence",
        "refine.parted",
    },
}
PRESETS = tuple(UNREAD)
# Labels on whole pixels: an offset only says on which.
UNREAD["thesis"] = UNREAD["edges"] | {"sides.vote.offset"}

# Bounds, and what only noise, dark scenes or uneven gains ask for.
SOMETIMES = {
    *(
        f"calibration.brightness.{n}"
        for n in (
            *("bright", "brightest", "gain_prior", "alike", "blur"),
            *("vignette_rough", "vignette_prior", "vignette_common", "vignette_outlier"),
            "vignette_side",
        )
    ),
    *(f"calibration.brightness.noise.{n}" for n in ("single", "between", "finest", "excess")),
    *(f"calibration.matching.{n}" for n in ("least_noise", "pooling.length", "pooling.step")),
    "smoothness.floor",
}


def _problem(name, size, preset, *, dtype: type = np.float64, **choices):
    blind = noisy_scene(name, size, dtype=dtype)
    # Differences see what is left of the solver's error, derivatives do not. At its default, drift
    # changes so little that rounding hides its slope before the kinks of all minima are apart.
    tight = {"solver.tolerance": 1e-12, "calibration.matching.drift": 0.03}
    if preset != "full":
        tight["sides.diffusion.solver.tolerance"] = 1e-10
    model = EdgeDepth.for_light_field(blind, preset=preset, choices=tight | choices)
    phase = jax.random.normal(jax.random.key(5), (size, size), dtype)

    def loss(tree):
        model, views = tree
        found = model(eqx.tree_at(lambda f: f.views, blind, views), key=jax.random.key(0))
        # Relative to what the views tell: errors reach the width of the range.
        error = jnp.mean(jnp.cos(phase) * jnp.log(found.error))
        return jnp.mean(jnp.sin(3 * found.disparity + phase)) + 0.1 * error

    return loss, model, blind.views


def _check(name, size, preset, *, unread=frozenset(), **choices):
    loss, model, views = _problem(name, size, preset, **choices)
    thresholds = {row.path for row in describe(model) if row.threshold}
    found = rows(loss, model, views, directions=2)
    check_rows(found, thresholds | UNREAD[preset] | unread, sometimes=SOMETIMES)


SCENES = pytest.mark.parametrize("name", ["edges", "demo"])


# Three programs of the whole chain each: `.ci/run` runs the first case after the fast tests.
@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("side", [40, 64, 96])
@SCENES
def test_every_leaf(name, side, preset):
    _check(name, side, preset)


# In `edges` two lines tie where disparities are those of the winning filters.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "interpolate"), [("demo", False), ("edges", True), ("demo", True)]
)
def test_every_leaf_of_the_thesis(name, interpolate):
    """With the disparity of the winning filter, which no blur moves, and one between filters."""
    lines = {"edges.lines.capacity": 64, "edges.lines.interpolate": interpolate}
    unread = frozenset() if interpolate else frozenset({"edges.lines.smoothing"})
    _check(name, 40, "thesis", unread=unread, **lines)


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
@SCENES
def test_the_taps_of_the_filters_reach_the_map(name, preset):
    """A random direction of each arm's taps. The filters' disparities only name them."""
    loss, model, views = _problem(name, 40, preset)

    def of_banks(tree):
        banks, views = tree
        return loss((model.replace({"edges.banks": banks}), views))

    assert isinstance(model.edges, OrientedEdges)
    banks = model.edges.prewitt(views.shape, views.dtype)
    found = rows(of_banks, banks, views, directions=0)
    check_rows(found, {"[0].disparity", "[1].disparity"})


def _small(name, preset, *, dtype: type = np.float64):
    choices = {"refine.sharpen.levels": 12, "refine.sharpen.radius": 3}
    return _problem(name, 32, preset, dtype=dtype, **choices)


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
@SCENES
def test_second_derivatives_of_the_chain(name, preset):
    """Forward over reverse, and what `linearize` gives, along a direction of everything."""
    loss, model, views = _small(name, preset)
    # In the logarithm of the numbers and in gray levels of the views: alike in size.
    logs = jax.tree.map(jnp.log, model)

    def value(tree):
        logs, change = tree
        return loss((jax.tree.map(jnp.exp, logs), views + change / 255))

    check_modes(value, (logs, jnp.zeros_like(views)), rtol=1e-3, step=1e-6, key=jax.random.key(2))


CANCEL = "sums that cancel round otherwise: 1e-10 changes `sharpen.epsilon` by 1e-4"


@pytest.mark.slow
@pytest.mark.parametrize(
    "scales",
    [
        (2.0**-33, 2.0**33, 2.0**66),  # which change no rounding
        pytest.param(
            (1e-20, 1e-10, 1e10, 1e20), marks=pytest.mark.xfail(reason=CANCEL, strict=True)
        ),
    ],
)
def test_the_chain_keeps_the_gradient_of_a_loss_of_any_size(scales):
    """In float32: what differs after a power of two has left the range."""
    loss, model, views = _small("edges", "full", dtype=np.float32)

    @jax.jit
    def gradient(scale):
        found = jax.grad(lambda tree: scale * loss(tree))((model, views))
        return jax.tree.leaves(found)

    expected = gradient(jnp.float32(1))
    for scale in map(np.float32, scales):
        for a, b in zip(gradient(scale), expected, strict=True):
            a, b = np.asarray(a, np.float64) / np.float64(scale), np.asarray(b, np.float64)
            assert np.abs(a - b).max() <= 1e-5 * np.abs(b).max(), scale
