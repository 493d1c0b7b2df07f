"""What learning lowers unless it is told otherwise."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax.lightfield import LightField

Loss = Callable[[Any, LightField], Float[Array, ""]]


def robust_loss(
    disparity: Float[Array, "y x"], light_field: LightField, *, scales: Sequence[float] = (0.03,)
) -> Float[Array, ""]:
    """Mean of `log(1 + (error / scale)²)` over the pixels whose truth is known, and over scales.

    Errors well above a scale count little more than those near it.

    Args:
        disparity: a map of the center view, px per view step.
        light_field: with ground truth, or a ValueError says that it has none.
        scales: px per view step, positive.

    Returns:
        The loss. Differentiable.
    """
    truth = light_field.truth
    if truth is None:
        raise ValueError(f"scene {light_field.name} has no ground truth to learn from.")
    error = jnp.where(truth.valid, disparity - truth.disparity, jnp.zeros_like(disparity))
    each = jnp.stack([jnp.log1p((error / scale) ** 2).sum() for scale in scales])
    return each.mean() / jnp.maximum(truth.valid.sum(), 1).astype(each.dtype)


@dataclass(frozen=True)
class RobustLoss:
    """`robust_loss` of the `disparity` of a result.

    Attributes:
        scales: px per view step. Bad pixels at .01, .03 and .07 px are what maps are judged by.

    Raises:
        ValueError: there is no scale, or one is not positive.
    """

    scales: tuple[float, ...] = (0.01, 0.03, 0.07, 0.3)

    def __post_init__(self) -> None:
        if not self.scales or not all(scale > 0 for scale in self.scales):
            raise ValueError(f"`scales` must be positive, one at least, got {self.scales}.")

    def __call__(self, result: Any, light_field: LightField) -> Float[Array, ""]:
        """The loss of a result with a `disparity`."""
        return robust_loss(result.disparity, light_field, scales=self.scales)
