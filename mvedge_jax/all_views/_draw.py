"""Draws samples into a view: nearest in front, holes filled from behind, edges by color."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax.warping import Outline, holes, outline

from ._samples import Samples, landed

# Differences of disparity beyond this, px, are steps between two surfaces.
STEP = 0.1


class Drawing(NamedTuple):
    """The sample that every pixel of a view shows.

    `hole` pixels have no sample of their own and show that of a neighbor; `spread` is the
    difference of the surfaces around a hole, px, 0 elsewhere.
    """

    sample: Int[Array, "y x"]
    hole: Bool[Array, "y x"]
    spread: Float[Array, "y x"]


def drawn(samples: Samples, step: Float[Array, "2"], shape: tuple[int, int]) -> Drawing:
    """Draws samples into a view; holes continue the farthest of the surfaces around them.

    Of a view without any sample, sample 0 is shown. A selection: no gradient passes.
    """
    disparity = lax.stop_gradient(samples.disparity)
    place, pixels = landed(samples, step, shape), shape[0] * shape[1]
    nearest = jnp.full(pixels + 1, -jnp.inf, disparity.dtype)
    nearest = nearest.at[place].max(disparity, mode="promise_in_bounds")
    wins = disparity == nearest[place]
    own = jnp.arange(disparity.size, dtype=jnp.int32)
    # The first of equal ones, independent of the order in which a device writes.
    winner = jnp.full(pixels + 1, disparity.size, jnp.int32)
    winner = winner.at[jnp.where(wins, place, pixels)].min(own, mode="promise_in_bounds")
    winner, nearest = winner[:-1].reshape(shape), nearest[:-1].reshape(shape)
    hit = jnp.isfinite(nearest)
    winner = jnp.where(hit, winner, 0)
    around = holes(nearest, hit, tolerance=STEP)
    return Drawing(winner.ravel()[around.behind], ~hit & ~around.crack, around.spread)


def decided(
    drawing: Drawing,
    samples: Samples,
    view: Float[Array, "c y x"],
    noise: Float[Array, ""],
    params: Outline,
) -> Drawing:
    """Decides by color on which side of a depth step the pixels beside it are; see `outline`."""
    disparity = samples.disparity[drawing.sample]
    shown = outline(disparity, view, noise, params)
    return drawing._replace(sample=drawing.sample.ravel()[shown])
