"""The thesis' objective: the reprojection error (7.15), and views that were not used as judges."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._params import number
from mvedge_jax.lightfield import LightField
from mvedge_jax.losses import LossWeights
from mvedge_jax.losses.features import Colours
from mvedge_jax.losses.terms import Features

from .._host import compiled_render
from .._model import Renderer
from .._result import Verdict
from .._start import Start, StartFit, fit_to_map, trust_labels
from ..objectives import SelfSupervised, check_subset
from ..optimisation._routine import Rates
from ..optimisation._state import State
from ._approach import Approach, Prepared, crosshair_halves, explained
from ._polish import Bending, polish


class ByReprojection(Approach):
    """Minimises the reprojection error of every second view of the crosshair.

    The other half of it judges: unless the optimisation lowers their error by `margin`, it is
    dropped. On cotton the true map explains the views 0.7 % worse than that of `EdgeDepth`, and
    every optimisation that lowered the error by less than a tenth made the map worse: gloss,
    blurred image edges and bilinear interpolation have a say of that size.

    Attributes:
        fit: of the model to the first map, in which a tenth more points are added; None if the
            model of the start renders that map already.
        polish: of the map, afterwards.
        weights: of the terms of (7.16); that of SSIM counts with `similarity` only.
        features: what images are compared by.
        prior: weight of the labels' standard errors, see `Trust`.
        label: largest change of a label, px per view step.
        margin: share by which the held-out error must fall, or the first map is polished instead;
            minus infinity keeps every result.
        rates: learning rates.
        iterations: how many, by default.
        subset: views drawn anew for every iteration, or None for all.
        similarity: compute the SSIM term, which costs as much as the rest of the loss.

    Raises:
        ValueError: `subset` is below 1.

    Source:
        Thesis 7.1.4, Eq. 7.15-7.16.

    Example:
        >>> ByReprojection(subset=2).margin.item()
        0.1
    """

    fit: StartFit | None = eqx.field(default_factory=StartFit)
    polish: Bending = eqx.field(default_factory=Bending)
    weights: LossWeights = eqx.field(default_factory=LossWeights)
    features: Features = eqx.field(default_factory=Colours)
    prior: Float[Array, ""] = number(1e-3)
    label: Float[Array, ""] = number(0.05)
    margin: Float[Array, ""] = number(0.1)
    rates: Rates = eqx.field(default_factory=Rates.self_supervised)
    iterations: int = eqx.field(static=True, default=40)
    subset: int | None = eqx.field(static=True, default=None)
    similarity: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        check_subset(self.subset)

    def prepare(self, light_field: LightField, start: Start, renderer: Renderer) -> Prepared:
        """Fits the model to the first map.

        Args:
            light_field: its crosshair of views is read.
            start: see `Start`.
            renderer: of the model.

        Returns:
            Model and objective.
        """
        if self.fit is not None:
            start = fit_to_map(start, self.fit, renderer)
        trust = trust_labels(start, weight=self.prior, label=self.label)
        training, _ = crosshair_halves(light_field)
        goal = SelfSupervised(
            training,
            trust,
            renderer,
            self.weights,
            self.features,
            self.subset,
            self.similarity,
        )
        return Prepared(start, start.disparity, start.disparity, goal)

    def finish(
        self, light_field: LightField, prepared: Prepared, state: State
    ) -> tuple[Float[Array, "y x"], Verdict]:
        """The first map, changed as the model changed if the judges want it, and polished.

        Args:
            light_field: its crosshair of views is read.
            prepared: from `prepare`.
            state: of the optimisation.

        Returns:
            The map, px per view step, and the verdict on the change before it was polished.
        """
        before, goal = prepared.first, prepared.objective
        # The model's own error in rendering the first map does not enter.
        changed, same = (
            compiled_render(model, goal.renderer, start=guess).disparity
            for model, guess in ((state.best, state.disparity), (prepared.start.model, before))
        )
        after = before + changed - same
        error = explained(light_field, before, after, self.features)
        margin = self.margin.astype(error.dtype)
        kept = jnp.isneginf(margin) | (error[1] < (1 - margin) * error[0])
        return polish(jnp.where(kept, after, before), self.polish), Verdict(error, kept)
