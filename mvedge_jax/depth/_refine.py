"""Inputs and options of the chain's diffusions."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import lineax as lx
from jaxtyping import Array, Float

from mvedge_jax._params import at_least, number
from mvedge_jax.photometry import PreparedViews
from mvedge_jax.photometry.matching import Hypotheses
from mvedge_jax.smoothness import Smoothness
from mvedge_jax.warping import Outline

from ._dense import DenseLabels
from ._labels import Labels
from ._sharpen import Sharpen
from ._slopes import Slopes
from ._standard_error import StandardError


class Refine(eqx.Module):
    """How labels become a map: weights of the diffusion, and when to sharpen and solve again.

    With dense labels: sharpening, `solves` diffusions, sharpening, `solves` diffusions, and, where
    they are measured in all views, `around` more. Without: `solves` diffusions and one sharpening.

    Attributes:
        precision: standard error at which a label counts half as much as a perfect one.
        stiffness: weight of an uncut edge between pixels against a perfect label.
        slopes: diffusion of the map's slopes; None for a map that is as flat as its labels allow.
        sharpen: moves depth steps onto color steps.
        error: standard error of the map from those of labels.
        worse_at_first: a pixel follows the first sharpened map unless its residual grows by more
            than this factor (plus twice this, squared noise): the median removes structures
            thinner than half of its window, and the views show them. At first, thin structures are
            not yet fitted to the views.
        worse: the same factor for the second sharpening.
        parted: step beside a pixel that halves the share of all views in its label: views in the
            corners of the grid look past an edge on two sides and blur it.
        coarser: solves for slopes and errors stop at this many times the tolerance of the map.
        accepted: least weight of an accepted label, that of a standard error of ten times
            `precision`. Only the statistics use it.
        outline: assigns a pixel beside a step to the surface that covers most of it; None to keep
            the diffused value.
        solves: diffusions between two sharpenings.
        around: solves at the end with labels measured in all views, if `Measurement.views` is
            `"all"`.
        beside: distance from a step within which labels of all views lose weight, px.
    """

    precision: Float[Array, ""] = number(0.005, "px")
    stiffness: Float[Array, ""] = number(1.5, "perfect labels")
    slopes: Slopes | None = eqx.field(default_factory=Slopes)
    sharpen: Sharpen = eqx.field(default_factory=Sharpen)
    error: StandardError = eqx.field(default_factory=StandardError)
    worse_at_first: Float[Array, ""] = number(1.2, threshold=True)
    worse: Float[Array, ""] = number(2.0, threshold=True)
    parted: Float[Array, ""] = number(0.1, "px")
    coarser: Float[Array, ""] = number(10.0, "tolerances", threshold=True)
    accepted: Float[Array, ""] = number(0.01, "perfect labels", threshold=True)
    outline: Outline | None = eqx.field(default_factory=Outline)
    solves: int = eqx.field(static=True, default=2)
    around: int = eqx.field(static=True, default=2)
    beside: int = eqx.field(static=True, default=2)

    def __check_init__(self) -> None:
        at_least(self, solves=1, around=1, beside=0)


class Map(NamedTuple):
    """A map, the standard error of its labels, and the convergence of the diffusions.

    Attributes:
        disparity: `[y, x]`.
        error: standard error of the labels that every pixel is diffused from; 0 without labels.
            `StandardError` turns it into that of the map.
        iterations: solver iterations of every diffusion of the map.
        converged: whether all diffusions reached their tolerance.
        labeled: share of the pixels with an accepted label in the last solve.
    """

    disparity: Array
    error: Array
    iterations: Array
    converged: Array
    labeled: Array


def labeled_share(labels: Labels, refine: Refine) -> Array:
    """Share of the pixels with an accepted label."""
    return jnp.mean((labels.weight >= refine.accepted).astype(labels.weight.dtype))


class Given(NamedTuple):
    """Inputs of all solves.

    Attributes:
        from_points: labels of the points, with weight 0 where there is none.
        views: prepared views of a light field or of posed photographs; None without dense labels.
        lab: the reference view in CIELAB, denoised, `[c, y, x]`.
        guide: the same in sRGB.
        span: width of the range that was searched, px: the standard error of a map without
            evidence.
        depth_edge: depth-edge confidence, px per px, `[y, x]`.
        lit: 0 in the vignette mask, where labels have no weight and no edge is cut.
        hypotheses: of the first map; None if there are none.
    """

    from_points: Labels
    views: PreparedViews | None
    lab: Float[Array, "c y x"]
    guide: Float[Array, "c y x"]
    span: Float[Array, ""]
    depth_edge: Float[Array, "y x"]
    lit: Float[Array, "y x"] | None = None
    hypotheses: Hypotheses | None = None


class Parts(NamedTuple):
    """The parts of the chain that turn labels into a map."""

    dense: DenseLabels | None
    smoothness: Smoothness
    solver: lx.AbstractLinearSolver
    refine: Refine


def cut_edges(given: Given, disparity: Array, smoothness: Smoothness) -> tuple[Array, Array]:
    """Smoothness by the steps of a map; 1 between neighbors of which one is not lit.

    Raises:
        ValueError: the weights are not those of edges to the right and downwards.
    """
    tx, ty = smoothness(given.lab, disparity, given.depth_edge)
    height, width = disparity.shape
    wanted = (height, width - 1), (height - 1, width)
    if (tx.shape, ty.shape) != wanted:
        raise ValueError(
            f"`smoothness` must return weights of the edges to the right, {wanted[0]}, and "
            f"downwards, {wanted[1]}; got {tx.shape} and {ty.shape}."
        )
    if given.lit is None:
        return tx, ty
    across, down = given.lit[:, 1:] * given.lit[:, :-1], given.lit[1:] * given.lit[:-1]
    return jnp.maximum(tx, 1 - across), jnp.maximum(ty, 1 - down)
