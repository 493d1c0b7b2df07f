"""Drawing samples into a view: the nearest one in front, holes from behind, edges by colour."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax.warping import Outline, holes, outline

from ._samples import Samples, landed

# Differences of disparity beyond this, px, are steps between two surfaces.
STEP = 0.1


class Drawing(NamedTuple):
    """Which sample every pixel of a view shows.

    Attributes:
        sample: its index.
        hole: where none landed and the sample is a neighbour's.
        spread: what the surfaces around a hole differ by, px; 0 elsewhere.
    """

    sample: Int[Array, "y x"]
    hole: Bool[Array, "y x"]
    spread: Float[Array, "y x"]


def drawn(samples: Samples, step: Float[Array, "2"], shape: tuple[int, int]) -> Drawing:
    """Draws samples into a view; in a hole, the farthest of the surfaces around it goes on.

    Args:
        samples: at least one of them lands in the view, or sample 0 is shown.
        step: `(u_c - u, v_c - v)` of the view.
        shape: of the view, px.

    Returns:
        The drawing. A selection: no gradient passes.
    """
    disparity = lax.stop_gradient(samples.disparity)
    place, pixels = landed(samples, step, shape), shape[0] * shape[1]
    nearest = jnp.full(pixels + 1, -jnp.inf, disparity.dtype)
    nearest = nearest.at[place].max(disparity, mode="promise_in_bounds")
    wins = disparity == nearest[place]
    own = jnp.arange(disparity.size, dtype=jnp.int32)
    # Of equal ones the first, in whatever order a device writes.
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
    """Decides by colour which side of a depth step the pixels beside it are on; see `outline`.

    Args:
        drawing: of the view.
        samples: that it shows.
        view: its picture, sRGB.
        noise: standard deviation of the picture's noise, sRGB.
        params: see `Outline`.

    Returns:
        The drawing, in which pixels beside steps show the front or the back surface. A selection.
    """
    disparity = samples.disparity[drawing.sample]
    shown = outline(disparity, view, noise, params)
    return drawing._replace(sample=drawing.sample.ravel()[shown])
