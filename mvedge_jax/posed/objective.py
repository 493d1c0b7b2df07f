"""The thesis' photometric loss of a map, for posed photographs."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.ndimage import map_coordinates
from jaxtyping import Array, Float, PRNGKeyArray

from mvedge_jax._params import cast
from mvedge_jax.losses import LossTerms, LossWeights
from mvedge_jax.losses.terms import edge_aware_smoothness, gradient_reward, ssim
from mvedge_jax.model import DepthModel, Renderer, render_model
from mvedge_jax.model.objectives import Trust
from mvedge_jax.photometry.views import ViewSet


class PosedReprojection(eqx.Module):
    """Photometric error of the photographs, warped by a model's map: an objective for `optimize`.

    Attributes:
        views: the reference first.
        trust: limits of the parameters.
        renderer: of the model.
        weights: of the terms.
    """

    views: ViewSet
    trust: Trust
    renderer: Renderer
    weights: LossWeights

    def __call__(
        self, model: DepthModel, start: Float[Array, "y x"], *, key: PRNGKeyArray | None = None
    ) -> tuple[Float[Array, ""], Float[Array, "y x"]]:
        """Loss and map."""
        disparity = render_model(model, self.renderer, start=start).disparity
        return posed_loss(disparity, self.views, self.weights), disparity

    def project(self, model: DepthModel) -> DepthModel:
        """The nearest model within the limits."""
        return self.trust.project(model)


def posed_loss(
    disparity: Float[Array, "y x"], views: ViewSet, weights: LossWeights
) -> Float[Array, ""]:
    """The loss (7.16) of a photograph's map: `self_supervised_loss`, for posed photographs.

    Args:
        disparity: of the first photograph, px per baseline.
        views: all views, the reference first.
        weights: of the terms.

    Returns:
        The loss. Visibility, by `Parallax.seen`, is a selection; differentiable in all arguments.

    Source: Thesis 7.1.4, Eq. 7.15-7.16, with the homographies of posed photographs.
    """
    weights = cast(weights, disparity.dtype)
    center = views.center

    def one(view: ViewSet) -> tuple[Array, Array]:
        x, y = view.parallax.positions(disparity)
        seen = view.parallax.seen(disparity, 1)
        shown = jax.vmap(lambda plane: map_coordinates(plane, [y, x], order=1, mode="nearest"))
        return jnp.where(seen[None], shown(view.planes), center), seen

    warped, seen = jax.vmap(one)(views.others)
    # Hidden pixels show the reference itself: their difference is 0.
    total = jnp.sum(jnp.mean(jnp.abs(warped - center[None]), axis=1), axis=0)
    count = jnp.maximum(jnp.sum(seen, axis=0).astype(disparity.dtype), 1)
    alike = jnp.mean(jax.vmap(lambda image: ssim(image, center))(warped))
    error = total / count
    smoothness = jnp.mean(edge_aware_smoothness(disparity, center))
    reward = jnp.mean(gradient_reward(total))
    terms = LossTerms(jnp.mean(error), smoothness, 1 - alike, reward, error)
    return terms.weighted(weights)
