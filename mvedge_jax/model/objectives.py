"""Objectives of the optimization: losses of the rendered map, priors on the parameters."""

from typing import Protocol, runtime_checkable

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
from mvedge_jax.losses.features import Colors
from mvedge_jax.losses.terms import Features

from ._model import DepthModel, Renderer, render_model


@runtime_checkable
class Objective(Protocol):
    """The protocol of a loss for `optimize`: a pytree that is called with the model.

    Any `equinox.Module` with these two methods is an objective. It is an argument of a compiled
    loop: its arrays are traced, everything else must be a static field. If it has a `renderer`
    (`Renderer`), `optimize` warns of points that the rendering cuts off.

    Example:
        >>> from mvedge_jax.model.optimization import Rates, all_at_once, begin, optimize
        >>> class Mean(eqx.Module):
        ...     target: Float[Array, ""]
        ...     renderer: Renderer
        ...     def __call__(self, model, start, *, key):
        ...         disparity = render_model(model, self.renderer, start=start).disparity
        ...         return (jnp.mean(disparity) - self.target) ** 2, disparity
        ...     def project(self, model):
        ...         return model
        >>> one, image = jnp.ones(1), jnp.zeros((4, 6))
        >>> model = DepthModel(0 * one, jnp.array([[3.0, 2.0]]), 0 * one, image, one > 0)
        >>> goal = Mean(jnp.asarray(0.1), Renderer.on_raster(1))
        >>> routine = all_at_once(Rates.supervised(), iterations=20)
        >>> state, _ = optimize(begin(model, image, key=jax.random.key(0)), routine, goal)
        >>> bool(abs(state.best.disparity - 0.1).max() < 0.02)
        True
    """

    def __call__(
        self, model: DepthModel, start: Float[Array, "y x"], *, key: PRNGKeyArray
    ) -> tuple[Float[Array, ""], Float[Array, "y x"]]:
        """Loss of `model`, differentiable in it, and the map it renders.

        `start` is the previous map, as the start of a solve; `key` is new in every iteration.
        """
        ...

    def project(self, model: DepthModel) -> DepthModel:
        """The nearest allowed model; called after every step."""
        ...


class Trust(eqx.Module):
    """Prior and limits of the parameters.

    The prior keeps a label near its initial value, in units of its standard error, which is far
    below what the photometric loss of a single pixel tells; the limits bound all changes.

    Attributes:
        origin: the parameters at the start.
        error: standard error of each label, px per view step.
        weight: weight of the mean of `((Z - Z_0) / error)²`, bounded for outliers by a Cauchy
            function.
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
        """Penalty of changes of the labels."""
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
    """Limits without a prior: only R and Q are bounded.

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
        known: mask of known pixels.
        trust: limits and prior.
        renderer: of the model.
        weights: of the terms.
    """

    truth: Float[Array, "y x"]
    known: Bool[Array, "y x"]
    trust: Trust
    renderer: Renderer = eqx.field(default_factory=Renderer)
    weights: SupervisedWeights = eqx.field(default_factory=SupervisedWeights)

    def __call__(
        self, model: DepthModel, start: Float[Array, "y x"], *, key: PRNGKeyArray | None = None
    ) -> tuple[Float[Array, ""], Float[Array, "y x"]]:
        """Loss and map."""
        disparity = render_model(model, self.renderer, start=start).disparity
        loss = supervised_loss(disparity, self.truth, self.known, self.weights)
        return loss + self.trust.penalty(model), disparity

    def project(self, model: DepthModel) -> DepthModel:
        """The nearest model within the limits."""
        return self.trust.project(model)


def check_subset(subset: int | None) -> None:
    """Refuses to draw no view at all.

    Args:
        subset: how many views, or None for all.
    """
    if subset is not None and subset < 1:
        raise ValueError(f"`subset` must be at least 1, or None for all views, got {subset}.")


class SelfSupervised(eqx.Module):
    """Photometric error of the views, warped by the rendered map.

    Attributes:
        views: the views.
        trust: limits and prior.
        renderer: of the model.
        weights: of the terms.
        features: image features to compare.
        subset: number of views drawn in every iteration, or None for all.
        similarity: compute the SSIM term at all, see `self_supervised_loss`.
    """

    views: Views
    trust: Trust
    renderer: Renderer = eqx.field(default_factory=Renderer)
    weights: LossWeights = eqx.field(default_factory=LossWeights)
    features: Features = eqx.field(default_factory=Colors)
    subset: int | None = eqx.field(static=True, default=None)
    similarity: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        check_subset(self.subset)

    def __call__(
        self, model: DepthModel, start: Float[Array, "y x"], *, key: PRNGKeyArray
    ) -> tuple[Float[Array, ""], Float[Array, "y x"]]:
        """Loss and map."""
        disparity = render_model(model, self.renderer, start=start).disparity
        views = self.views
        if self.subset is not None:
            count = views.steps.shape[0]
            views = views.take(jax.random.permutation(key, count)[: min(self.subset, count)])
        loss, _ = self_supervised_loss(
            disparity, views, self.weights, features=self.features, similarity=self.similarity
        )
        return loss + self.trust.penalty(model), disparity

    def project(self, model: DepthModel) -> DepthModel:
        """The nearest model within the limits."""
        return self.trust.project(model)
