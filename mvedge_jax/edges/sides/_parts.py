"""The part `sides`: the surface that each label belongs to, and depth edges."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._cpu import checkpoint_stage
from mvedge_jax._params import as_number, at_least, cast
from mvedge_jax.color import srgb_to_gray
from mvedge_jax.image import gradient_magnitude
from mvedge_jax.photometry import Evidence

from .._points import EdgePoints
from ._bidirectional import Bidirectional, DirectionalDiffusion, bidirectional
from ._evidence import map_evidence
from ._profile import step_response, thesis_response, thesis_step
from ._reprojection import reprojection_score
from ._surface import SideVote, SurfaceVectors, choose, surface_vectors


class Sides(NamedTuple):
    """The side of its edge that each label belongs to.

    Attributes:
        surface: the choice of each point.
        confidence: depth-edge confidence of every point, `[n]`: `lambda_e` of (6.3), px, or how
            much like a step its profile is, see `ThesisSides.stretched`.
        edge: depth-edge confidence of every pixel (Thesis 4.3), px per px, `[y, x]`.
        initial: a map of the labels, px per view step, `[y, x]`.
        iterations: solver iterations of the diffusions, `[k]`.
    """

    surface: SurfaceVectors
    confidence: Float[Array, " n"]
    edge: Float[Array, "y x"]
    initial: Float[Array, "y x"]
    iterations: Array


@runtime_checkable
class SideChoice(Protocol):
    """Chooses the side of every edge point; called inside `jit`.

    Points that are not valid get no offset and no preference. The choice of the more likely side
    is a selection; scores and probabilities are differentiable.
    """

    def __call__(self, points: EdgePoints, evidence: Evidence) -> Sides:
        """Chooses sides.

        Args:
            points: the edge points.
            evidence: calibrated views and measurement; `measured` may be None.

        Returns:
            See `Sides`.
        """
        ...


class MapSides(eqx.Module):
    """Sides by neighboring labels and by the measured map.

    Attributes:
        vote: weights of the evidence; `response` is not read.
    """

    vote: SideVote = eqx.field(default_factory=SideVote)

    def __call__(self, points: EdgePoints, evidence: Evidence) -> Sides:
        """See `SideChoice`; the map gives the depth-edge confidence of a point."""
        if evidence.measured is None:
            raise ValueError("`MapSides` need a `measurement` in the chain, got None.")
        first = evidence.measured.disparity
        vote = cast(self.vote, first.dtype)
        step = jnp.abs(map_evidence(points, first, cap=vote.cap))
        edge = gradient_magnitude(first)
        surface = _voted(points, None, first, vote, evidence.shape)
        return Sides(surface, step, edge, first, jnp.zeros(0, jnp.int32))


class BidirectionalSides(eqx.Module):
    """Sides by two directional diffusions, by neighboring labels and by the measured map.

    Attributes:
        diffusion: of the labels from either side of their edges (4.2.2).
        vote: weights of the evidence.
    """

    diffusion: DirectionalDiffusion = eqx.field(default_factory=DirectionalDiffusion)
    vote: SideVote = eqx.field(default_factory=SideVote)

    def __call__(self, points: EdgePoints, evidence: Evidence) -> Sides:
        """See `SideChoice`."""
        passes = _both_ways(points, evidence, self.diffusion, step_response)
        first = None if evidence.measured is None else evidence.measured.disparity
        surface = _voted(points, passes.response, first, self.vote, evidence.shape)
        return _sides(surface, passes)


class ThesisSides(eqx.Module):
    """Sides by the step response of two directional diffusions alone.

    Profiles are stretched to [-1, 1] before the step filter.

    Attributes:
        diffusion: of the labels from either side of their edges.
        vote: its `offset` and `temperature` are read.
        stretched: whether the depth-edge confidence of a point also is the response to stretched
            profiles, at most 4, whatever the height of the step. Otherwise it is that to the
            profiles themselves, px, as in Eq. 6.3.

    Source: Thesis 4.2.2, 6.1.
    """

    diffusion: DirectionalDiffusion = eqx.field(default_factory=DirectionalDiffusion)
    vote: SideVote = eqx.field(default_factory=SideVote)
    stretched: bool = eqx.field(static=True, default=True)

    @staticmethod
    def printed() -> "ThesisSides":
        """The thesis' form: Eq. 4.11, label weights of 1e6, 1 / (gradient + 1e-4); Eq. 6.3.

        The thesis does not give epsilon; 1e-4 is the value of the authors' program.
        """
        diffusion = DirectionalDiffusion(
            data=as_number(1e6 * 1e-4), gradient=as_number(1e-4), floor=as_number(1e-6),
            form="inverse",
        )  # fmt: skip
        return ThesisSides(diffusion, stretched=False)

    def __call__(self, points: EdgePoints, evidence: Evidence) -> Sides:
        """See `SideChoice`."""
        confide = thesis_response if self.stretched else thesis_step
        passes = _both_ways(points, evidence, self.diffusion, thesis_response, confide)
        return _sides(choose(points, passes.response, self.vote), passes)


class ReprojectionSides(eqx.Module):
    """Sides by the directional map that reprojects better: the baseline of Tab. 6.2.

    Attributes:
        diffusion: of the labels from either side of their edges.
        vote: its `offset` and `temperature` are read.
        radius: largest distance of occluders, px.

    Source: Thesis 6.2.4, Tab. 6.2.
    """

    radius: int = eqx.field(static=True)
    diffusion: DirectionalDiffusion = eqx.field(default_factory=DirectionalDiffusion)
    vote: SideVote = eqx.field(default_factory=SideVote)

    def __check_init__(self) -> None:
        at_least(self, radius=1)

    def __call__(self, points: EdgePoints, evidence: Evidence) -> Sides:
        """See `SideChoice`."""
        passes = _both_ways(points, evidence, self.diffusion, thesis_response)
        arms = evidence.calibrated.arms
        score = reprojection_score(
            points, passes.forward, passes.backward, *arms, radius=self.radius
        )
        return _sides(choose(points, score, self.vote), passes)


class NoSides(eqx.Module):
    """Labels stay on their edges; the naive variant of Fig. B.1."""

    def __call__(self, points: EdgePoints, evidence: Evidence) -> Sides:
        """See `SideChoice`."""
        nothing = jnp.zeros_like(points.disparity)
        surface = choose(points, nothing, cast(SideVote(), nothing.dtype))
        count = jnp.sum(points.valid.astype(nothing.dtype))
        mean = jnp.sum(jnp.where(points.valid, points.disparity, 0)) / jnp.maximum(count, 1)
        flat = jnp.zeros(evidence.shape, nothing.dtype)
        return Sides(surface, nothing, flat, flat + mean, jnp.zeros(0, jnp.int32))


def _voted(
    points: EdgePoints,
    response: Array | None,
    first: Array | None,
    vote: SideVote,
    shape: tuple[int, int],
) -> SurfaceVectors:
    stage = checkpoint_stage(partial(surface_vectors, shape=shape))
    return stage(points, response, first, vote)


def _both_ways(
    points: EdgePoints,
    evidence: Evidence,
    params: DirectionalDiffusion,
    respond: Callable[[Float[Array, "7 n"]], Float[Array, " n"]],
    confide: Callable[[Float[Array, "7 n"]], Float[Array, " n"]] | None = None,
) -> Bidirectional:
    gray = srgb_to_gray(jnp.moveaxis(evidence.calibrated.guide, 0, -1))
    stage = checkpoint_stage(partial(bidirectional, respond=respond, confide=confide or respond))
    return stage(points, gray, cast(params, gray.dtype))


def _sides(surface: SurfaceVectors, passes: Bidirectional) -> Sides:
    initial = 0.5 * (passes.forward + passes.backward)
    return Sides(surface, passes.confidence, passes.edge, initial, passes.iterations)
