"""Learning-rate tables: one parameter at a time as in the thesis, or all at once."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import number


class Rates(eqx.Module):
    """Learning rates of Adam and their decay per pass, of Q, Z, R and xy in this order.

    The defaults are those of the thesis' routine. The class methods have rates for all parameters
    at once, chosen on scenes of `mvedge render` and on cotton.

    Attributes:
        rate: steps of Q, Z (px of disparity), R, xy (px).
        decay: factors per pass.

    Source: The authors' published code.
    """

    rate: Float[Array, "4"] = number((0.015, 0.015, 0.015, 0.1))
    decay: Float[Array, "4"] = number((0.9, 0.9, 0.8, 0.75))

    @classmethod
    def supervised(cls) -> "Rates":
        """For `Supervised`: large rates, as the start is far from the known map."""
        return cls(jnp.asarray([0.15, 0.01, 0.08, 0.1]))

    @classmethod
    def evidence(cls) -> "Rates":
        """For the linearized evidence of the views (`ByEvidence`)."""
        return cls(jnp.asarray([0.1, 0.004, 0.1, 0.04]))

    @classmethod
    def self_supervised(cls) -> "Rates":
        """For `SelfSupervised` from a model fitted to a depth map: small rates."""
        return cls(jnp.asarray([0.02, 0.0005, 0.02, 0.01]))


class Routine(eqx.Module):
    """Learning rates of every iteration.

    Attributes:
        rates: learning rates of Q, Z, R, xy per iteration.
        restart: whether to reset the moments of Adam before this iteration.
    """

    rates: Float[Array, "i 4"]
    restart: Bool[Array, "i"]

    @property
    def length(self) -> int:
        """Number of iterations."""
        return self.restart.size

    def part(self, start: int, stop: int) -> "Routine":
        """Iterations from `start` up to `stop`."""
        return Routine(self.rates[start:stop], self.restart[start:stop])


def one_at_a_time(rates: Rates, *, iterations: int = 13, passes: int = 5) -> Routine:
    """The thesis' routine: Q, Z, R, xy in turns, a fresh Adam for each.

    Args:
        rates: learning rates.
        iterations: per parameter and pass.
        passes: number of passes.

    Returns:
        A table of `4 * iterations * passes` iterations.

    Source: Thesis 7.1.5, "Routine".
    """
    dtype = rates.rate.dtype
    turn = np.repeat(np.tile(np.eye(4), (passes, 1)), iterations, axis=0)
    power = np.repeat(np.arange(passes), 4 * iterations)[:, None]
    decay = rates.decay[None] ** jnp.asarray(power, dtype)
    table = rates.rate[None] * decay * jnp.asarray(turn, dtype)
    restart = np.arange(len(turn)) % iterations == 0
    return Routine(table, jnp.asarray(restart))


def all_at_once(rates: Rates, *, iterations: int = 100) -> Routine:
    """All parameters together, with learning rates that fall to a tenth along a cosine.

    Args:
        rates: learning rates; the decay is not used.
        iterations: number of iterations.

    Returns:
        A table of `iterations` iterations.
    """
    phase = np.arange(iterations) / max(iterations - 1, 1)
    factor = 0.1 + 0.9 * 0.5 * (1 + np.cos(np.pi * phase))
    table = rates.rate[None] * jnp.asarray(factor, rates.rate.dtype)[:, None]
    return Routine(table, jnp.zeros(iterations, bool))
