"""The evidence of all views, linearized and confirmed by halves: the default objective."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax.lightfield import LightField
from mvedge_jax.losses import all_views, gather_views
from mvedge_jax.losses.features import Colors
from mvedge_jax.losses.terms import Features
from mvedge_jax.photometry import occluder_radius

from .._host import compiled_render
from .._model import Renderer
from .._result import Verdict
from .._start import Start, StartFit, fit_to_map, trust_labels
from ..objectives import Supervised
from ..optimization._routine import Rates
from ..optimization._state import State
from ._approach import Approach, Prepared, explained
from ._evidence import ViewAgreement, agreed_correction
from ._polish import Bending, polish


class ByEvidence(Approach):
    """Minimizes the linearized photometric error of all views that two halves of them confirm.

    The loss is the photometric error of *all* views, linearized around the map with the color
    drift eliminated, as far as held-out views confirm it (`agreed_correction`): a quadratic form
    in the rendered map, minimized over Z, xy, R and Q. The plain reprojection error (7.15) is
    biased by gloss and blurred edges: on *cotton* the true map explains the views worse than that
    of `EdgeDepth`.

    Attributes:
        fit: fit of the model to the first map, which adds a tenth of the points.
        evidence: parameters of the measured correction.
        polish: polishing of the map, before and after.
        rates: learning rates.
        iterations: number of iterations until convergence at these rates.
        features: image features compared in the verdict, which does not affect the result.

    Example:
        >>> ByEvidence(iterations=20).features
        Colors()
    """

    fit: StartFit = eqx.field(default_factory=StartFit)
    evidence: ViewAgreement = eqx.field(default_factory=ViewAgreement)
    polish: Bending = eqx.field(default_factory=Bending)
    rates: Rates = eqx.field(default_factory=Rates.evidence)
    iterations: int = eqx.field(static=True, default=12)
    features: Features = eqx.field(default_factory=Colors)

    def prepare(self, light_field: LightField, start: Start, renderer: Renderer) -> Prepared:
        """Fits the model to the polished first map and measures the correction by all views.

        What the model cannot reproduce of `base` is not corrected.
        """
        views = gather_views(light_field, choice=all_views(light_field))
        first = start.disparity
        base = polish(first, self.polish)
        start = fit_to_map(start._replace(disparity=base), self.fit, renderer)
        rendered = compiled_render(start.model, renderer, start=base).disparity
        height, width = base.shape
        reach = occluder_radius(float(jnp.ptp(base)), light_field.farthest, (height, width))
        correction = agreed_correction(views, base, self.evidence, radius=reach)
        trust = trust_labels(start, weight=0.0, label=self.evidence.largest)
        known = jnp.ones(base.shape, bool)
        target = rendered + correction.change
        goal = Supervised(target, known, trust, renderer)
        return Prepared(start._replace(disparity=rendered), first, base, goal, correction)

    def finish(
        self, light_field: LightField, prepared: Prepared, state: State
    ) -> tuple[Float[Array, "y x"], Verdict]:
        """The refined map: the first one plus the change of the model, polished.

        A pixel's change is clipped so that it is nearer to the measured correction than no change.
        This prevents errors beside depth edges, which a model of points reproduces worst.
        """
        goal, rendered, correction = (
            prepared.objective,
            prepared.start.disparity,
            prepared.correction,
        )
        assert correction is not None
        after = compiled_render(state.best, goal.renderer, start=rendered).disparity
        twice = 2 * correction.change
        change = jnp.clip(after - rendered, jnp.minimum(twice, 0), jnp.maximum(twice, 0))
        refined = polish(prepared.base + change, self.polish)
        error = explained(light_field, prepared.first, refined, self.features)
        return refined, Verdict(error, jnp.asarray(True), jnp.mean(correction.share))
