"""L-BFGS for the supervised loss, by Optimistix."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, Int

from .._model import DepthModel
from ..objectives import Supervised
from ._state import with_parts


class Minimised(NamedTuple):
    """The best model found.

    Attributes:
        model: the parameters.
        loss: before any step, and of `model`.
        steps: how many steps were done.
    """

    model: DepthModel
    loss: Float[Array, "2"]
    steps: Int[Array, ""]


@eqx.filter_jit
def minimise_lbfgs(
    model: DepthModel,
    objective: Supervised,
    *,
    steps: int = 50,
    scales: Float[Array, "4"] | tuple[float, ...] = (1.0, 0.1, 1.0, 0.5),
) -> Minimised:
    """Minimises the supervised loss with all parameters at once.

    Quasi-Newton steps suit a smooth, deterministic loss: give the squared error a weight.

    Args:
        model: where to start.
        objective: the loss; its limits are applied to the parameters before each evaluation.
        steps: most steps.
        scales: typical changes of Q, Z, R and xy; the search happens in these units.

    Returns:
        The best model seen.
    """
    dtype = model.disparity.dtype
    units = jnp.asarray(scales).astype(dtype)
    origin = (model.roughness, model.disparity, model.log_weight, model.xy)
    start = objective.truth

    def unpack(change: tuple[Array, ...]) -> DepthModel:
        q, z, r, xy = (o + u * c for o, u, c in zip(origin, units, change, strict=True))
        return objective.project(with_parts(model, (q, z, r, xy)))

    def loss(change: tuple[Array, ...], _: None) -> Array:
        return objective(unpack(change), start)[0]

    zero = tuple(jnp.zeros_like(part) for part in origin)
    solver = optx.BestSoFarMinimiser(optx.LBFGS(rtol=1e-6, atol=1e-8))
    solution = optx.minimise(loss, solver, zero, max_steps=steps, throw=False)
    first, last = loss(zero, None), loss(solution.value, None)
    return Minimised(unpack(solution.value), jnp.stack([first, last]), solution.stats["num_steps"])
