"""The number of slots for points in a model."""

import jax.numpy as jnp
import numpy as np

from ._model import DepthModel


def without_free_places(model: DepthModel) -> DepthModel:
    """Drops the slots of a model that hold no point.

    Args:
        model: the model, not traced, because the number of points sets the shape.

    Returns:
        The model with as many slots as points, in their order.
    """
    there = np.flatnonzero(np.asarray(model.valid))
    return DepthModel(
        model.disparity[there],
        model.xy[there],
        model.log_weight[there],
        model.roughness,
        model.valid[there],
    )


def with_capacity(model: DepthModel, capacity: int) -> DepthModel:
    """Appends free slots to the model.

    Args:
        model: the model.
        capacity: number of slots, at least that of the model.

    Returns:
        The model with `capacity` slots.

    Raises:
        ValueError: the model already has more slots.
    """
    extra = capacity - model.valid.size
    if extra < 0:
        raise ValueError(
            f"`capacity` is {capacity}, but the model has {model.valid.size} places already."
        )
    return DepthModel(
        jnp.pad(model.disparity, (0, extra)),
        jnp.pad(model.xy, ((0, extra), (0, 0))),
        jnp.pad(model.log_weight, (0, extra)),
        model.roughness,
        jnp.pad(model.valid, (0, extra)),
    )
