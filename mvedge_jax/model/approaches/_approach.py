"""The interface of the objectives of `optimize_edges`."""

import abc
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._compiler import lean_jit
from mvedge_jax.lightfield import LightField
from mvedge_jax.losses import LossWeights, Views, gather_views, self_supervised_loss
from mvedge_jax.losses.terms import Features

from .._model import Renderer
from .._result import Verdict
from .._start import Start
from ..objectives import SelfSupervised, Supervised
from ..optimization._routine import Rates
from ..optimization._state import State
from ._evidence import Correction


class Prepared(NamedTuple):
    """A prepared optimization.

    Attributes:
        start: the initial model, and the initial map of its first solve.
        first: the given map.
        base: the map that the optimization corrects, such as the polished first map.
        objective: the loss to minimize from `start.model`.
        correction: the correction that the views support, if it was measured.
    """

    start: Start
    first: Float[Array, "y x"]
    base: Float[Array, "y x"]
    objective: Supervised | SelfSupervised
    correction: Correction | None = None


class Approach(eqx.Module):
    """An objective of `optimize_edges` with its parameters; abstract.

    Attributes:
        rates: learning rates that suit the objective.
        iterations: default number of iterations.
        features: image features compared in the verdict.
    """

    rates: eqx.AbstractVar[Rates]
    iterations: eqx.AbstractVar[int]
    features: eqx.AbstractVar[Features]

    @abc.abstractmethod
    def prepare(self, light_field: LightField, start: Start, renderer: Renderer) -> Prepared:
        """Model and objective to optimize."""

    @abc.abstractmethod
    def finish(
        self, light_field: LightField, prepared: Prepared, state: State
    ) -> tuple[Float[Array, "y x"], Verdict]:
        """The final map from the optimized model and the first map, and its validation."""


def crosshair_halves(light_field: LightField) -> tuple[Views, Views]:
    """Every second view on either arm, for training, and the others, for validation."""
    views = gather_views(light_field)
    count = views.steps.shape[0]
    return views.take(jnp.arange(0, count, 2)), views.take(jnp.arange(1, count, 2))


def explained(
    light_field: LightField,
    before: Float[Array, "y x"],
    after: Float[Array, "y x"],
    features: Features,
) -> Float[Array, "2"]:
    """Reprojection error (7.15) of two maps in the validation views."""
    _, held_out = crosshair_halves(light_field)
    run = lean_jit(self_supervised_loss)
    return jnp.stack(
        [
            run(disparity, held_out, LossWeights(), features=features)[1].reprojection
            for disparity in (before, after)
        ]
    )
