"""Stencils evaluated in parts of an image only."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

# Side of a block, px, and how many are computed at once: enough that XLA uses all cores. Results do
# not depend on either.
_SIDE, _BATCH = 16, 32


def in_blocks(
    stencil: Callable[[Float[Array, "b c h w"]], Float[Array, "b k y x"]],
    wanted: Bool[Array, "y x"],
    images: Float[Array, "c y x"],
    *,
    reach: int,
) -> Float[Array, "k y x"]:
    """Evaluates a stencil in the blocks of an image that need it; 0 elsewhere.

    The number of blocks is known at run time only, so a `stencil` with derivatives supports forward
    mode alone.

    Args:
        stencil: maps stacks of pieces of the images, `reach` px larger on each side, to its results
            in them.
        wanted: pixels whose result is read.
        images: inputs of the stencil; 0 beyond their borders.
        reach: radius of the stencil, px.
    """
    height, width = wanted.shape
    rows, columns = -(-height // _SIDE), -(-width // _SIDE)
    lacking = (rows * _SIDE - height, columns * _SIDE - width)
    margin = [(reach, reach + end) for end in lacking]
    images = jnp.pad(images, ((0, 0), *margin))
    busy = jnp.pad(wanted, [(0, end) for end in lacking])
    busy = jnp.any(busy.reshape(rows, _SIDE, columns, _SIDE), axis=(1, 3)).ravel()
    blocks, batch = rows * columns, min(_BATCH, rows * columns)
    which = jnp.nonzero(busy, size=blocks + batch, fill_value=blocks)[0].astype(jnp.int32)
    piece = (images.shape[0], _SIDE + 2 * reach, _SIDE + 2 * reach)

    def some(turn: Array, answers: Array) -> Array:
        here = lax.dynamic_slice(which, (turn * batch,), (batch,))
        y, x = here // columns * _SIDE, here % columns * _SIDE
        corners = (jnp.zeros_like(y), y, x)
        pieces = jax.vmap(lambda *corner: lax.dynamic_slice(images, corner, piece))(*corners)
        return answers.at[here].set(stencil(pieces), mode="drop")

    shapes = jax.eval_shape(stencil, jax.ShapeDtypeStruct((batch, *piece), images.dtype))
    answers = jnp.zeros((blocks, *shapes.shape[1:]), shapes.dtype)
    turns = (jnp.sum(busy, dtype=jnp.int32) + batch - 1) // batch
    answers = lax.fori_loop(0, turns, some, answers)
    answers = answers.reshape(rows, columns, -1, _SIDE, _SIDE).transpose(2, 0, 3, 1, 4)
    return answers.reshape(-1, rows * _SIDE, columns * _SIDE)[:, :height, :width]
