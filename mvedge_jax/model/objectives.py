"""What the optimisation minimises: losses of the rendered map, priors on the parameters."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from mvedge_jax._params import cast, number
from mvedge_jax.losses import (
    LossWeights,
    SupervisedWeights,
    Views,
    self_supervised_loss,
    supervised_loss,
)
from mvedge_jax.losses.features import Colours
from mvedge_jax.losses.terms import Features

from ._model import DepthModel, ModelParams, ModelSizes, render_model


class Trust(eqx.Module):
    """How far the parameters may go, and what going costs.

    Points from `multiview_edges` are known to a few thousandths of a pixel, far better than the
    photometric loss of a single pixel can tell. The prior keeps a label near its first value in
    units of its standard error; the limits keep everything within reach.

    Attributes:
        origin: the parameters at the start.
        error: standard error of each label, px per view step.
        weight: of the mean of `((Z - Z_0) / error)²`, capped for outliers by a Cauchy function.
        label: largest change of a label, px per view step.
        position: largest change of a position along each axis, px.
        log_weight: largest |R|.
        roughness: lowest and highest Q.
    """

    origin: DepthModel
    error: Float[Array, "n"]
    weight: Float[Array, ""] = number(0.0)
    label: Float[Array, ""] = number(float("inf"))
    position: Float[Array, ""] = number(float("inf"))
    log_weight: Float[Array, ""] = number(8.0)
    roughness: Float[Array, "2"] = number((-4.0, 14.0))

    def penalty(self, model: DepthModel) -> Float[Array, ""]:
        """Cost of leaving the first labels."""
        trust = cast(self, model.disparity.dtype)
        moved = (model.disparity - trust.origin.disparity) / jnp.maximum(trust.error, 1e-6)
        cost = jnp.where(model.valid, jnp.log1p(jnp.where(model.valid, moved, 0) ** 2), 0)
        count = jnp.maximum(jnp.sum(model.valid).astype(cost.dtype), 1)
        return trust.weight * jnp.sum(cost) / count

    def project(self, model: DepthModel) -> DepthModel:
        """Clips the parameters to the limits."""
        trust = cast(self, model.disparity.dtype)
        z, xy = trust.origin.disparity, trust.origin.xy
        return DepthModel(
            jnp.clip(model.disparity, z - trust.label, z + trust.label),
            jnp.clip(model.xy, xy - trust.position, xy + trust.position),
            jnp.clip(model.log_weight, -trust.log_weight, trust.log_weight),
            jnp.clip(model.roughness, trust.roughness[0], trust.roughness[1]),
            model.valid,
        )


def unlimited(model: DepthModel) -> Trust:
    """Trust without a prior: only R and Q are limited.

    Args:
        model: the parameters at the start.

    Returns:
        The trust.
    """
    return Trust(model, jnp.ones_like(model.disparity))


class Supervised(eqx.Module):
    """Distance of the rendered map from a known one.

    Attributes:
        truth: the known map.
        known: where it is known.
        trust: limits and prior.
        params: of the rendering.
        weights: of the terms.
        sizes: of the rendering.
    """

    truth: Float[Array, "y x"]
    known: Bool[Array, "y x"]
    trust: Trust
    params: ModelParams = eqx.field(default_factory=ModelParams)
    weights: SupervisedWeights = eqx.field(default_factory=SupervisedWeights)
    sizes: ModelSizes = eqx.field(static=True, default_factory=ModelSizes)

    def __call__(
        self, model: DepthModel, start: Float[Array, "y x"], *, key: PRNGKeyArray | None = None
    ) -> tuple[Float[Array, ""], Float[Array, "y x"]]:
        """Loss and map."""
        disparity = render_model(model, self.params, self.sizes, start=start).disparity
        loss = supervised_loss(disparity, self.truth, self.known, self.weights)
        return loss + self.trust.penalty(model), disparity

    def project(self, model: DepthModel) -> DepthModel:
        """The nearest model within the limits."""
        return self.trust.project(model)


class SelfSupervised(eqx.Module):
    """How badly the rendered map explains the views.

    Attributes:
        views: the views.
        trust: limits and prior.
        params: of the rendering.
        weights: of the terms.
        features: what images are compared by.
        sizes: of the rendering.
        subset: views drawn anew for every iteration, or None for all.
    """

    views: Views
    trust: Trust
    params: ModelParams = eqx.field(default_factory=ModelParams)
    weights: LossWeights = eqx.field(default_factory=LossWeights)
    features: Features = eqx.field(default_factory=Colours)
    sizes: ModelSizes = eqx.field(static=True, default_factory=ModelSizes)
    subset: int | None = eqx.field(static=True, default=None)

    def __call__(
        self, model: DepthModel, start: Float[Array, "y x"], *, key: PRNGKeyArray
    ) -> tuple[Float[Array, ""], Float[Array, "y x"]]:
        """Loss and map."""
        disparity = render_model(model, self.params, self.sizes, start=start).disparity
        views = self.views
        if self.subset is not None:
            count = views.steps.shape[0]
            views = views.take(jax.random.permutation(key, count)[: min(self.subset, count)])
        loss, _ = self_supervised_loss(disparity, views, self.weights, features=self.features)
        return loss + self.trust.penalty(model), disparity

    def project(self, model: DepthModel) -> DepthModel:
        """The nearest model within the limits."""
        return self.trust.project(model)
