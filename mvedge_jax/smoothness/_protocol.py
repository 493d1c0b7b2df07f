"""The protocol of a smoothness."""

from typing import Protocol, runtime_checkable

from jaxtyping import Array, Float


@runtime_checkable
class Smoothness(Protocol):
    """Edge weights between neighboring pixels, relative to the caller's `stiffness`.

    An implementation is a pytree (an `equinox.Module`): its arrays are traced and differentiated.
    It may assume finite inputs of one floating dtype, and must return finite weights of that dtype
    in (0, 1]; it is called inside `jit` and under `vmap`, once per diffusion.

    Example:
        >>> import equinox as eqx, jax.numpy as jnp
        >>> class Uniform(eqx.Module):
        ...     def __call__(self, guide, disparity, depth_edge):
        ...         return jnp.ones_like(disparity[:, 1:]), jnp.ones_like(disparity[1:])
        >>> isinstance(Uniform(), Smoothness)
        True
    """

    def __call__(
        self,
        guide: Float[Array, "c y x"],
        disparity: Float[Array, "y x"],
        depth_edge: Float[Array, "y x"],
    ) -> tuple[Float[Array, "y x-1"], Float[Array, "y-1 x"]]:
        """Weights of the edges to the right and downwards.

        Args:
            guide: center view in CIELAB, L in 0..100, denoised.
            disparity: the map of the previous diffusion, px per view step.
            depth_edge: depth-edge confidence (Thesis 4.3), px per px; 0 where sides are not
                estimated.

        Returns:
            `tx` and `ty`, in (0, 1].
        """
        ...
