"""Self-supervised optimisation of the model: from the points and map of a first estimate."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax.losses import SupervisedWeights, Views

from ._evidence import Correction, EvidenceParams, agreed_correction
from ._model import DepthModel, ModelParams, ModelSizes, render_model
from ._objectives import Supervised
from ._polish import PolishParams, polish
from ._relocate import RelocateParams, relocate_steps
from ._start import Start, StartParams, fit_to_map, trust_labels


class RefineParams(eqx.Module):
    """Parameters of the refinement.

    Attributes:
        start: of the fit to the first map.
        evidence: of what the views say.
        polish: of the map, before and after.
        relocate: of the first map's depth steps, if the points' positions are in doubt; those of
            `edge_to_depth` are not.
    """

    start: StartParams = eqx.field(default_factory=StartParams)
    evidence: EvidenceParams = eqx.field(default_factory=EvidenceParams)
    polish: PolishParams = eqx.field(default_factory=PolishParams)
    relocate: RelocateParams | None = None


class Refinement(NamedTuple):
    """An optimisation that is ready to run.

    Attributes:
        start: the model that reproduces the first map, with the errors of its labels.
        base: the first map, polished.
        rendered: what the model of `start` renders; it differs from `base` by what the model
            cannot reproduce, which is not for the views to correct.
        correction: what the views say.
        objective: what to minimise, from `start.model` on.
    """

    start: Start
    base: Float[Array, "y x"]
    rendered: Float[Array, "y x"]
    correction: Correction
    objective: Supervised


def prepare_refinement(
    start: Start,
    first: Float[Array, "y x"],
    views: Views,
    params: RefineParams,
    rendering: ModelParams,
    sizes: ModelSizes,
    *,
    iterations: int = 30,
) -> Refinement:
    """Prepares the optimisation of a model against the views.

    The loss is the photometric error of *all* views, linearised around the map with the colour
    drift eliminated (`view_evidence`), as far as views that were not asked confirm it
    (`agreed_correction`): a quadratic in the rendered map, minimised over Z, xy, R and Q. The
    plain reprojection error (7.15) cannot take its place: on *cotton* the true map explains the
    views worse than that of `edge_to_depth`, since gloss and blurred edges have their say in it.

    Args:
        start: from `start_from_points`.
        first: the map of `edge_to_depth`.
        views: all that there are.
        params: see `RefineParams`.
        rendering: of the model.
        sizes: of the model.
        iterations: of the fit to the first map, in which a tenth more points are added.

    Returns:
        Model and objective for `optimise`; `finish_refinement` makes the map.
    """
    if params.relocate is not None:
        first = relocate_steps(first, views.centre, params.relocate)
    base = polish(first, params.polish)
    extra = int(jnp.sum(start.model.valid)) // 10
    start = fit_to_map(
        start, base, params.start, rendering, sizes, iterations=iterations, extra=extra
    )
    rendered = _render(start.model, rendering, sizes, start=base).disparity
    correction = agreed_correction(views, base, params.evidence)
    trust = trust_labels(start, weight=0.0, label=params.evidence.largest)
    weights = SupervisedWeights(square=jnp.asarray(3.0))
    known = jnp.ones(base.shape, bool)
    goal = Supervised(rendered + correction.change, known, trust, rendering, weights, sizes)
    return Refinement(start, base, rendered, correction, goal)


def finish_refinement(
    refinement: Refinement, model: DepthModel, params: RefineParams
) -> Float[Array, "y x"]:
    """The refined map: the first one, changed as the model changed, and polished.

    A pixel's change is clipped to where it is nearer to the views' correction than no change is:
    beside depth edges, which a model of points reproduces worst, nothing gets worse.

    Args:
        refinement: from `prepare_refinement`.
        model: the optimised model.
        params: see `RefineParams`.

    Returns:
        The map, px per view step.
    """
    goal = refinement.objective
    rendered = _render(model, goal.params, goal.sizes, start=refinement.rendered).disparity
    twice = 2 * refinement.correction.change
    change = rendered - refinement.rendered
    change = jnp.clip(change, jnp.minimum(twice, 0), jnp.maximum(twice, 0))
    return polish(refinement.base + change, params.polish)


_render = eqx.filter_jit(render_model)
