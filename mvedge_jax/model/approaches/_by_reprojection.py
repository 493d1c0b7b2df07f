"""The thesis' objective: the reprojection error (7.15), validated by held-out views."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._params import number
from mvedge_jax.lightfield import LightField
from mvedge_jax.losses import LossWeights, gather_views
from mvedge_jax.losses.features import Colors
from mvedge_jax.losses.terms import Features

from .._host import compiled_render
from .._model import Renderer
from .._result import Verdict
from .._start import Start, StartFit, fit_to_map, trust_labels
from ..objectives import SelfSupervised, check_subset
from ..optimization._routine import Rates
from ..optimization._state import State
from ._approach import Approach, Prepared, crosshair_halves, explained
from ._polish import Bending, polish


class ByReprojection(Approach):
    """Minimizes the reprojection error of every second view of the crosshair.

    The other half validates: unless the optimization lowers their error by `margin`, its result is
    dropped. On cotton every optimization that lowered the error by less than a tenth made the map
    worse: gloss, blurred image edges and bilinear interpolation cause a bias of that size. The
    thesis has neither validation nor prior, see `thesis`.

    Attributes:
        fit: fit of the model to the first map, which adds a tenth of the points; None if the
            initial model renders that map already.
        polish: polishing of the final map; None for none.
        weights: weights of the terms of (7.16); that of SSIM is used with `similarity` only.
        features: image features to compare.
        prior: weight of the labels' standard errors, see `Trust`.
        label: largest change of a label, px per view step.
        position: largest change of a position along each axis, px.
        margin: share by which the held-out error must fall, or the first map is polished instead;
            minus infinity keeps every result.
        rates: learning rates.
        iterations: default number of iterations.
        subset: number of views drawn in every iteration, or None for all.
        similarity: compute the SSIM term, which costs as much as the rest of the loss.
        held_out: minimize the error of every second view only; otherwise that of all, and nothing
            validates.

    Raises:
        ValueError: `subset` is below 1.

    Source: Thesis 7.1.4, Eq. 7.15-7.16.

    Example:
        >>> ByReprojection(subset=2).margin.item()
        0.1
    """

    fit: StartFit | None = eqx.field(default_factory=StartFit)
    polish: Bending | None = eqx.field(default_factory=Bending)
    weights: LossWeights = eqx.field(default_factory=LossWeights)
    features: Features = eqx.field(default_factory=Colors)
    prior: Float[Array, ""] = number(1e-3)
    label: Float[Array, ""] = number(0.05)
    position: Float[Array, ""] = number(1.0)
    margin: Float[Array, ""] = number(0.1)
    rates: Rates = eqx.field(default_factory=Rates.self_supervised)
    iterations: int = eqx.field(static=True, default=40)
    subset: int | None = eqx.field(static=True, default=None)
    similarity: bool = eqx.field(static=True, default=False)
    held_out: bool = eqx.field(static=True, default=True)

    def __check_init__(self) -> None:
        check_subset(self.subset)

    @classmethod
    def thesis(
        cls, features: Features | None = None, *, subset: int | None = None
    ) -> "ByReprojection":
        """The thesis' objective: all views of the crosshair, free points, no validation.

        Args:
            features: image features to compare; None for the colors.
            subset: number of views drawn in every iteration, or None for all.

        Returns:
            The approach, for a `Start` of `start_from_edges` and the routine `one_at_a_time`.

        Source: Thesis 7.1.4, 7.1.5.
        """
        free = jnp.asarray(jnp.inf)
        return cls(
            fit=None, polish=None, features=Colors() if features is None else features,
            prior=jnp.asarray(0.0), label=free, position=free, rates=Rates(), subset=subset,
            held_out=False,
        )  # fmt: skip

    def prepare(self, light_field: LightField, start: Start, renderer: Renderer) -> Prepared:
        """Fits the model to the first map."""
        if self.fit is not None:
            start = fit_to_map(start, self.fit, renderer)
        limits = {"label": self.label, "position": self.position}
        trust = trust_labels(start, weight=self.prior, **limits)
        views = crosshair_halves(light_field)[0] if self.held_out else gather_views(light_field)
        goal = SelfSupervised(
            views, trust, renderer, self.weights, self.features, self.subset, self.similarity
        )
        return Prepared(start, start.disparity, start.disparity, goal)

    def finish(
        self, light_field: LightField, prepared: Prepared, state: State
    ) -> tuple[Float[Array, "y x"], Verdict]:
        """The first map plus the change of the model, if held-out views confirm it; polished."""
        before, goal = prepared.first, prepared.objective
        # The model's error in rendering the first map cancels.
        changed, same = (
            compiled_render(model, goal.renderer, start=guess).disparity
            for model, guess in ((state.best, state.disparity), (prepared.start.model, before))
        )
        after = before + changed - same
        error = explained(light_field, before, after, self.features)
        margin = self.margin.astype(error.dtype)
        confirmed = error[1] < (1 - margin) * error[0]
        kept = confirmed | jnp.isneginf(margin) | (not self.held_out)
        final = jnp.where(kept, after, before)
        return final if self.polish is None else polish(final, self.polish), Verdict(error, kept)
