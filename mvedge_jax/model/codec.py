"""A depth map as points and a compact smoothness map: encode, decode, save."""

import math
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax.losses import SupervisedWeights
from mvedge_jax.splatting import SplatLabels, SplatWidths

from ._format import Parts, pack, unpack
from ._host import compiled_render
from ._model import DepthModel, Renderer
from .objectives import Supervised, unlimited
from .optimization._grow import worst_pixels
from .optimization._optimize import advance
from .optimization._routine import Rates, all_at_once
from .optimization._state import begin

_ROUGHNESS = 12.0
_LOG_WEIGHT = -4.0
_ROUNDS = 5
_MOST_BITS = 16


class Encoding(eqx.Module):
    """A depth map as points and cuts.

    Attributes:
        pixel: index of each point's pixel, row by row, ascending.
        label: label of each point, in `bits` bits.
        cut: pixels that are cut off from their left and upper neighbor.
        low: value of label 0.
        high: value of label `2**bits - 1`.
        bits: number of bits of a label, at most 16.
    """

    pixel: Int[Array, "n"]
    label: Int[Array, "n"]
    cut: Bool[Array, "y x"]
    low: Float[Array, ""]
    high: Float[Array, ""]
    bits: int = eqx.field(static=True, default=16)

    def save(self, path: str | Path) -> int:
        """Writes an encoding to a file.

        The format, version 1: `MVEC`, version and bits of a label (a byte each), height, width and
        number of points (4 bytes each), `low` and `high` (doubles), CRC-32 of the rest, all little
        endian; then the words of a range coder (constriction's queue) whose bits have adaptive
        probabilities. Cuts and positions of points are planes of bits, each in the context of the
        ten bits before it; positions also of the cuts around and of the grid of half of the
        points. Labels are differences from the nearest point before.

        Args:
            path: the file to write, `.mvec` by convention.

        Returns:
            Size of the file in bytes.

        Raises:
            ModuleNotFoundError: constriction is not installed (`mvedge_jax[codec]`).
        """
        cut, pixel = np.asarray(self.cut), np.asarray(self.pixel)
        point = np.zeros(cut.size, bool)
        point[pixel] = True
        ends = float(self.low), float(self.high)
        label = np.asarray(self.label)
        parts = Parts(cut, point.reshape(cut.shape), label, self.bits, ends)
        height, width = cut.shape
        return Path(path).write_bytes(pack(parts, _likely(height, width, len(pixel))))

    @staticmethod
    def load(path: str | Path) -> "Encoding":
        """Reads an encoding that `save` wrote.

        Args:
            path: the file.

        Returns:
            The encoding; its range has JAX's default precision.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the file holds something else, is damaged, or of another version.
            ModuleNotFoundError: constriction is not installed (`mvedge_jax[codec]`).
        """
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"There is no encoding at {path}.")
        try:
            parts = unpack(path.read_bytes(), _likely)
        except ValueError as error:
            raise ValueError(f"{path} is not an encoding that was saved: {error}.") from error
        pixel = np.flatnonzero(parts.point).astype(np.int32)
        low, high = map(jnp.asarray, parts.ends)
        label = jnp.asarray(parts.label, jnp.int32)
        return Encoding(jnp.asarray(pixel), label, jnp.asarray(parts.cut), low, high, parts.bits)


def _likely(height: int, width: int, count: int) -> np.ndarray:
    """Grid positions of half of the points."""
    return _first_points(height, width, max(count // 2, 1)).reshape(height, width)


def _renderer(dtype: np.dtype) -> Renderer:
    """Points are single pixels, so the profiles are narrow; `second` lets one bit cut one side."""
    label, weight = jnp.asarray(0.2, dtype), jnp.asarray(0.35, dtype)
    splat = SplatLabels(SplatWidths(sigma_label=label, sigma_weight=weight))
    return Renderer(splat, clears=False, pairing="second")


def _model(pixel: Array, label: Array, valid: Array, cut: Array) -> DepthModel:
    width = cut.shape[1]
    dtype = label.dtype
    xy = jnp.stack([pixel % width, pixel // width], axis=-1).astype(dtype)
    weight = jnp.full_like(label, _LOG_WEIGHT)
    rough = jnp.where(cut, jnp.asarray(_ROUGHNESS, dtype), jnp.zeros((), dtype))
    return DepthModel(label, xy, weight, rough, valid)


def _cuts(disparity: Float[Array, "y x"], step: Float[Array, ""]) -> Bool[Array, "y x"]:
    """Pixels whose left or upper neighbor differs by more than `step`."""
    jump = jnp.abs(disparity - jnp.roll(disparity, 1, 1)).at[:, 0].set(0)
    jump_y = jnp.abs(disparity - jnp.roll(disparity, 1, 0)).at[0].set(0)
    return jnp.maximum(jump, jump_y) > step


def encode(
    disparity: Float[Array, "y x"],
    k: int,
    *,
    step: Float[Array, ""] | float | None = None,
    iterations: int = 20,
    bits: int | None = None,
) -> Encoding:
    """Finds `k` points and a bit per pixel that reproduce a depth map.

    Half of the points start on a grid. The rest is added in rounds at the largest errors. Then all
    labels are optimized together.

    Args:
        disparity: the map, any unit, finite.
        k: number of points.
        step: jumps larger than this are cut; by default 2 % of the map's range.
        iterations: iterations of Adam on the labels at the end.
        bits: number of bits of a label, 1 to 16; by default as few as add a hundredth to the root
            mean squared error.

    Returns:
        The encoding.

    Raises:
        ValueError: `k` is below 1 or above the number of pixels, `bits` are not 1 to 16, or the map
            is not finite.

    Source:
        Thesis 1.1.1 and 7.2.3 (completeness).
    """
    if not 1 <= k <= disparity.size:
        raise ValueError(f"`k` must be from 1 to the {disparity.size} pixels there are, got {k}.")
    if bits is not None and not 1 <= bits <= _MOST_BITS:
        raise ValueError(f"`bits` must be from 1 to {_MOST_BITS}, got {bits}.")
    if not bool(jnp.isfinite(disparity).all()):
        raise ValueError("`disparity` must be finite, got NaN or infinity.")
    dtype = disparity.dtype
    low, high = jnp.min(disparity), jnp.max(disparity)
    spread = jnp.where(high > low, high - low, 1)
    cut = _cuts(disparity, 0.02 * spread if step is None else jnp.asarray(step).astype(dtype))
    renderer, flat, valid = _renderer(dtype), disparity.ravel(), np.zeros(k, bool)

    def current(taken: np.ndarray) -> tuple[DepthModel, Array]:
        pixel = np.zeros(k, np.int32)
        chosen = np.flatnonzero(taken)
        pixel[: chosen.size] = chosen
        valid[:] = np.arange(k) < chosen.size
        model = _model(jnp.asarray(pixel), flat[jnp.asarray(pixel)], jnp.asarray(valid), cut)
        return model, compiled_render(model, renderer).disparity

    taken = _first_points(cut.shape[0], cut.shape[1], max(k // 2, 1))
    for later in range(_ROUNDS):
        missing = k - int(taken.sum())
        if missing == 0:
            break
        last = later == _ROUNDS - 1
        error = jnp.abs(current(taken)[1] - disparity)
        error = jnp.where(jnp.asarray(taken.reshape(disparity.shape)), -1, error)
        # Blocks keep points apart, except for the last ones.
        xy, value = worst_pixels(
            error, missing if last else -(-missing // (_ROUNDS - later)), block=1 if last else 2
        )
        xy = np.asarray(xy)[np.asarray(value) >= 0]
        taken[xy[:, 1] * disparity.shape[1] + xy[:, 0]] = True
    model, reproduced = current(taken)
    if iterations:
        known = jnp.ones(disparity.shape, bool)
        weights = SupervisedWeights(square=jnp.asarray(0.0))
        goal = Supervised(disparity, known, unlimited(model), renderer, weights)
        rate = jnp.asarray([0, 0.002, 0, 0], dtype) * spread
        state = begin(model, reproduced, key=jax.random.key(0))
        routine = all_at_once(Rates(rate=rate), iterations=iterations)
        model = advance(state, routine, goal)[0].best
    top = jnp.maximum(high, jnp.max(model.disparity))
    bottom = jnp.minimum(low, jnp.min(model.disparity))
    spread = jnp.where(top > bottom, top - bottom, 1)
    if bits is None:
        bits = _enough(compiled_render(model, renderer).disparity - disparity, spread)
    level = (model.disparity - bottom) / spread * (2**bits - 1)
    pixel = jnp.asarray(np.flatnonzero(taken).astype(np.int32))
    return Encoding(pixel, jnp.round(level).astype(jnp.int32), cut, bottom, bottom + spread, bits)


def _enough(error: Float[Array, "y x"], spread: Float[Array, ""]) -> int:
    """Bits of labels whose steps are half of the error: rounding adds a hundredth to it."""
    wanted = 2 * float(spread) / max(math.sqrt(float(jnp.mean(error**2))), 1e-30)
    return min(max(math.ceil(math.log2(wanted + 1)), 1), _MOST_BITS)


def _first_points(height: int, width: int, count: int) -> np.ndarray:
    """Marks at most `count` pixels on a square grid, at least one."""
    side = max(int(np.ceil(np.sqrt(height * width / count))), 1)
    y, x = np.mgrid[side // 2 : height : side, side // 2 : width : side]
    taken = np.zeros(height * width, bool)
    taken[(y * width + x).ravel()[:count]] = True
    if not taken.any():
        taken[taken.size // 2] = True
    return taken


def decode(encoding: Encoding) -> Float[Array, "y x"]:
    """Reproduces the depth map.

    Args:
        encoding: from `encode` or `Encoding.load`.

    Returns:
        The map.
    """
    dtype = encoding.low.dtype
    scale = (encoding.high - encoding.low) / (2**encoding.bits - 1)
    label = encoding.low + encoding.label.astype(dtype) * scale
    valid = jnp.ones(label.shape, bool)
    model = _model(encoding.pixel, label, valid, encoding.cut)
    return compiled_render(model, _renderer(dtype)).disparity
