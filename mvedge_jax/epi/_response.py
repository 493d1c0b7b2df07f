"""Responses of the filter bank."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._linear_map import linear_map
from mvedge_jax._params import accepts_numpy
from mvedge_jax._product import FULL
from mvedge_jax._root import safe_sqrt

from ._bank import FilterBank

# Rows that are filtered together: memory against speed, no choice of results.
_ROWS = 16
_LAYOUT = ("NWC", "WIO", "NWC")


@jax.custom_jvp
def correlate(rows: Float[Array, "b x i"], taps: Float[Array, "k i w"]) -> Float[Array, "b x2 k"]:
    """Correlates rows of `i` channels with `k` sets of taps; only where the taps fit.

    Bilinear. Derivatives in both are again such correlations: the transposes that XLA derives
    itself take some fifty times as long on a CPU.
    """
    kernel = jnp.transpose(taps, (2, 1, 0))
    return lax.conv_general_dilated(
        rows, kernel, (1,), "VALID", dimension_numbers=_LAYOUT, precision=FULL
    )


@correlate.defjvp
def _correlate_jvp(
    primals: tuple[Array, Array], tangents: tuple[Array, Array]
) -> tuple[Array, Array]:
    (rows, taps), (rows_dot, taps_dot) = primals, tangents
    along_rows = linear_map(lambda t, r: correlate(r, t), _rows_from, taps, rows_dot)
    along_taps = linear_map(correlate, _taps_from, rows, taps_dot)
    return correlate(rows, taps), along_rows + along_taps


def _rows_from(taps: Float[Array, "k i w"], out: Float[Array, "b x2 k"]) -> Float[Array, "b x i"]:
    """The transpose of `correlate` with respect to the rows."""
    reach = taps.shape[2] - 1
    padded = jnp.pad(out, ((0, 0), (reach, reach), (0, 0)))
    return correlate(padded, jnp.swapaxes(taps, 0, 1)[..., ::-1])


def _taps_from(rows: Float[Array, "b x i"], out: Float[Array, "b x2 k"]) -> Float[Array, "k i w"]:
    """The transpose of `correlate` with respect to the taps."""
    length = out.shape[1]

    def tap(offset: Array) -> Array:
        seen = lax.dynamic_slice_in_dim(rows, offset, length, axis=1)
        return jnp.einsum("bxk,bxi->ki", out, seen, precision=FULL)

    return jnp.moveaxis(lax.map(tap, jnp.arange(rows.shape[1] - length + 1)), 0, -1)


def in_row_blocks(function: Callable[[Array], Array], rows: Array) -> Array:
    """Maps `function` over blocks of rows, which bounds the memory."""
    count = rows.shape[0]
    block = min(_ROWS, count)
    blocks = -(-count // block)
    padded = jnp.pad(rows, [(0, blocks * block - count)] + [(0, 0)] * (rows.ndim - 1))
    out = lax.map(function, padded.reshape(blocks, block, *rows.shape[1:]))
    return out.reshape(-1, *out.shape[2:])[:count]


def _by_blocks(
    arm: Float[Array, "u y x c"], bank: FilterBank, reduced: Callable[[Array], Array]
) -> Array:
    """`reduced` of the responses `[y, c, x, k]` to a few rows at a time, for all rows.

    Rows are padded with their edge values: zeros would invent an edge at the border.
    """
    radius, channels = bank.radius, arm.shape[3]
    padded = jnp.pad(arm, ((0, 0), (0, 0), (radius, radius), (0, 0)), mode="edge")
    taps = bank.taps.astype(arm.dtype)

    @jax.checkpoint
    def block(rows: Array) -> Array:
        out = correlate(rows.reshape(-1, *rows.shape[2:]), taps)
        return reduced(out.reshape(-1, channels, *out.shape[1:]))

    return in_row_blocks(block, jnp.transpose(padded, (1, 3, 2, 0)))


def bank_response(arm: Float[Array, "u y x c"], bank: FilterBank) -> Float[Array, "y x c k"]:
    """Response of every filter at every pixel of the center view, per channel, with its sign.

    `sum_u sum_w taps[k, u, w] arm[u, y, x + w - radius, c]`: linear, hence differentiable, in the
    views and in the taps. For the vertical arm swap x and y first.

    Raises:
        ValueError: if the bank was made for another number of views.

    Source: Thesis 4.1.1.
    """
    if bank.taps.shape[1] != arm.shape[0]:
        raise ValueError(f"`bank` is for {bank.taps.shape[1]} views, `arm` has {arm.shape[0]}.")
    return _by_blocks(arm, bank, lambda response: jnp.swapaxes(response, 1, 2))


@accepts_numpy
def strongest_response(arm: Float[Array, "u y x c"], bank: FilterBank) -> Float[Array, "y x"]:
    """The largest response over the filters, Euclidean norm over the channels, at every pixel.

    Args:
        arm: the views of one arm of the crosshair. For the vertical arm swap x and y first.
        bank: the filters.

    Returns:
        `max_k |r_k|`. Differentiable in views and taps, at the filter that wins; the slope where
        there is no response at all is 0.

    Source: Thesis 4.1.1.
    """

    def strongest(response: Array) -> Array:
        energy = (response**2).sum(1)
        best = jnp.argmax(energy, axis=-1)
        return safe_sqrt(jnp.take_along_axis(energy, best[..., None], axis=-1)[..., 0])

    return _by_blocks(arm, bank, strongest)
