"""The chain in two halves, each a program of its own: labels, and their diffusion."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from mvedge_jax._checks import sound
from mvedge_jax._cpu import checkpoint_stage
from mvedge_jax._params import cast
from mvedge_jax.edges import EdgeDetector, Edges
from mvedge_jax.edges.sides import SideChoice, SurfaceVectors
from mvedge_jax.image import gradient_magnitude
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import Calibration, Evidence, Noise, gather_evidence
from mvedge_jax.photometry.brightness import Exposure
from mvedge_jax.photometry.measuring import Measurement
from mvedge_jax.warping import outline

from ._labels import PointLabels
from ._refine import Given, Map, Parts, Refine
from ._result import DepthResult, DepthStats
from .solves import refine_disparity


class Front(eqx.Module):
    """The parts of an `EdgeDepth` that find and place labels.

    Attributes:
        precision: see `Refine`.
        searched: see `EdgeDepth`.
        dense: whether labels are measured at every pixel, too.
    """

    calibration: Calibration
    measurement: Measurement | None
    edges: EdgeDetector
    sides: SideChoice
    labels: PointLabels
    precision: Float[Array, ""]
    searched: tuple[float, float] = eqx.field(static=True)
    dense: bool = eqx.field(static=True)


class Labeled(NamedTuple):
    """What the diffusions read, and what is reported of the steps before them.

    Attributes:
        given: labels and prepared views.
        first: the map to start from, `[y, x]`.
        edges: the points.
        surface: their surface vectors.
        noise: of the views.
        exposure: removed from the views.
        iterations: of the diffusions that chose the sides, `[k]`.
        searched: lowest and highest disparity, px per view step.
        sound: whether all numbers of the parts were finite and none negative.
    """

    given: Given
    first: Float[Array, "y x"]
    edges: Edges
    surface: SurfaceVectors
    noise: Noise
    exposure: Exposure
    iterations: Array
    searched: Float[Array, "2"]
    sound: Bool[Array, ""]


def find_labels(light_field: LightField, parts: Front, key: PRNGKeyArray | None) -> Labeled:
    """The first half of the chain: from views to labels on pixels."""
    parts = cast(parts, light_field.views.dtype)
    evidence = gather_evidence(light_field, parts.calibration, parts.measurement, parts.searched)
    edges = found_edges(parts.edges, evidence, key)
    sides = parts.sides(edges.points, evidence)
    labels = parts.labels(edges.points, sides, evidence, parts.precision)

    views, measured = evidence.calibrated, evidence.measured
    searched = jnp.asarray(parts.searched, views.lab.dtype)
    return Labeled(
        Given(
            labels,
            evidence.prepared if parts.dense else None,
            views.lab,
            views.guide,
            searched[1] - searched[0],
            sides.edge,
            views.lit,
            views.hypotheses,
        ),
        measured.disparity if parts.dense and measured is not None else sides.initial,
        edges,
        sides.surface,
        views.noise,
        views.exposure,
        sides.iterations,
        searched,
        sound(parts),
    )


def diffuse_labels(labeled: Labeled, parts: Parts) -> DepthResult:
    """The second half of the chain: from labels to a map."""
    parts = cast(parts, labeled.first.dtype)
    return result_of(refine_disparity(labeled.given, labeled.first, parts), labeled, parts)


def result_of(found: Map, labeled: Labeled, parts: Parts) -> DepthResult:
    """Outlines, standard errors and statistics of a map."""
    given, fine = labeled.given, sound(parts) & labeled.sound
    disparity, error = _outlined(found, labeled, parts.refine, fine)
    stats = DepthStats(
        labeled.edges.stats,
        jnp.sum(given.from_points.weight > 0),
        jnp.sum(labeled.edges.points.valid & (labeled.surface.score != 0)),
        jnp.concatenate([labeled.iterations, found.iterations]),
        found.converged & fine,
        labeled.noise,
        labeled.exposure,
        fine,
        labeled.searched,
    )
    # With a label at every pixel, the map itself is the best source of depth edges.
    edge = given.depth_edge if parts.dense is None else gradient_magnitude(disparity)
    return DepthResult(disparity, error, edge, labeled.edges.points, labeled.surface, stats)


def found_edges(detector: EdgeDetector, evidence: Evidence, key: PRNGKeyArray | None) -> Edges:
    """Runs an edge detector, which reverse mode runs again."""
    return checkpoint_stage(lambda evidence, edges: edges(evidence, key=key))(evidence, detector)


def _outlined(
    found: Map, labeled: Labeled, refine: Refine, fine: Bool[Array, ""]
) -> tuple[Array, Array]:
    """Disparity and standard error after each pixel beside a step has taken one surface."""
    disparity, error = found.disparity, found.error
    if refine.outline is not None:
        shown = outline(disparity, labeled.given.guide, labeled.noise.deviation, refine.outline)
        disparity, error = (jnp.ravel(a)[shown] for a in (disparity, error))
    # `where` hides NaN parameters, so NaN is propagated explicitly.
    unknown = jnp.asarray(jnp.nan, disparity.dtype)
    hypotheses = labeled.given.hypotheses
    around = None if hypotheses is None else hypotheses.variance_around(disparity)
    error = refine.error(error, disparity, around)
    return jnp.where(fine, disparity, unknown), jnp.where(fine, error, unknown)
