"""A depth map as points and a compact smoothness map: encode, decode, save."""

import zlib
from dataclasses import replace
from pathlib import Path
from zipfile import BadZipFile

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax.losses import SupervisedWeights
from mvedge_jax.splatting import SplatParams

from ._model import DepthModel, ModelParams, ModelSizes, compiled_render
from .objectives import Supervised, unlimited
from .optimisation._grow import worst_pixels
from .optimisation._optimise import advance
from .optimisation._routine import Rates, all_at_once
from .optimisation._state import begin

# Points are single pixels here, so the profiles are narrow; `second` lets one bit cut one side.
_SIZES = replace(ModelSizes.on_raster(1), clears=False, pairing="second")
_ROUGHNESS = 12.0
_LOG_WEIGHT = -4.0
_ROUNDS = 5


class Encoding(eqx.Module):
    """A depth map as points and cuts.

    Attributes:
        pixel: of each point, counted row by row, ascending.
        label: 16-bit label of each point.
        cut: pixels that are cut off from their left and upper neighbour.
        low: label of 0.
        high: label of 65535.
    """

    pixel: Int[Array, "n"]
    label: Int[Array, "n"]
    cut: Bool[Array, "y x"]
    low: Float[Array, ""]
    high: Float[Array, ""]

    def save(self, path: str | Path) -> int:
        """Writes an encoding to an `.npz` file.

        Args:
            path: where to write; the name should end in `.npz`.

        Returns:
            Size of the file in bytes.
        """
        path = Path(path)
        index = np.asarray(self.pixel, np.int64)
        gap = np.diff(index, prepend=0)
        kind = (
            np.uint8 if gap.max(initial=0) < 256 else np.uint16 if gap.max() < 65536 else np.uint32
        )
        # Differences of neighbours, high and low bytes apart: what deflate packs best.
        change = np.diff(np.asarray(self.label, np.int64), prepend=0).astype(np.uint16)
        with path.open("wb") as file:
            np.savez_compressed(
                file,
                gap=gap.astype(kind),
                high_bytes=(change >> 8).astype(np.uint8),
                low_bytes=(change & 255).astype(np.uint8),
                cut=np.packbits(np.asarray(self.cut)),
                shape=np.asarray(self.cut.shape, np.int32),
                range=np.asarray([self.low, self.high]),
            )
        return path.stat().st_size

    @staticmethod
    def load(path: str | Path) -> "Encoding":
        """Reads an encoding that `save` wrote.

        Args:
            path: the file.

        Returns:
            The encoding.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the file holds something else.
        """
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"There is no encoding at {path}.")
        try:
            # Given a name, NumPy leaves what is no archive open.
            with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
                parts = _unpacked({name: file[name] for name in file})
        except (BadZipFile, zlib.error, EOFError, OSError, TypeError, ValueError) as error:
            reason = str(error).strip().rstrip(".")
            raise ValueError(f"{path} is not an encoding that was saved: {reason}.") from error
        return Encoding(*(jnp.asarray(part) for part in parts))


def _unpacked(arrays: dict[str, np.ndarray]) -> tuple[np.ndarray, ...]:
    """Pixels, labels, cuts and both ends of the range; a ValueError where they do not agree."""
    names = {"gap", "high_bytes", "low_bytes", "cut", "shape", "range"}
    if set(arrays) != names:
        raise ValueError(f"it has the arrays {sorted(arrays)}, expected {sorted(names)}")
    index = np.cumsum(arrays["gap"].astype(np.int64))
    change = arrays["high_bytes"].astype(np.uint16) * 256 + arrays["low_bytes"]
    label = np.cumsum(change, dtype=np.uint16).astype(np.int32)
    height, width = map(int, arrays["shape"])
    if len(index) != len(label) or index.max(initial=0) >= height * width:
        raise ValueError(
            f"it claims {height}x{width} px, and has {len(index)} points, the last at pixel "
            f"{index.max(initial=0)}, with {len(label)} labels"
        )
    cut = np.unpackbits(arrays["cut"])[: height * width].astype(bool).reshape(height, width)
    low, high = arrays["range"]
    if arrays["range"].dtype.kind != "f" or not -np.inf < low <= high < np.inf:
        raise ValueError(f"its range is {low} to {high}, expected finite numbers in order")
    return index.astype(np.int32), label, cut, np.asarray(low), np.asarray(high)


def _params(dtype: np.dtype) -> ModelParams:
    narrow = SplatParams(sigma_label=jnp.asarray(0.2, dtype), sigma_weight=jnp.asarray(0.35, dtype))
    return ModelParams(splat=narrow)


def _model(pixel: Array, label: Array, valid: Array, cut: Array) -> DepthModel:
    width = cut.shape[1]
    dtype = label.dtype
    xy = jnp.stack([pixel % width, pixel // width], axis=-1).astype(dtype)
    weight = jnp.full_like(label, _LOG_WEIGHT)
    rough = jnp.where(cut, jnp.asarray(_ROUGHNESS, dtype), jnp.zeros((), dtype))
    return DepthModel(label, xy, weight, rough, valid)


def _cuts(disparity: Float[Array, "y x"], step: Float[Array, ""]) -> Bool[Array, "y x"]:
    """Pixels whose left or upper neighbour differs by more than `step`."""
    jump = jnp.abs(disparity - jnp.roll(disparity, 1, 1)).at[:, 0].set(0)
    jump_y = jnp.abs(disparity - jnp.roll(disparity, 1, 0)).at[0].set(0)
    return jnp.maximum(jump, jump_y) > step


def encode(
    disparity: Float[Array, "y x"],
    k: int,
    *,
    step: Float[Array, ""] | float | None = None,
    iterations: int = 20,
) -> Encoding:
    """Finds `k` points and a bit per pixel that reproduce a depth map.

    Half of the points start on a grid; the rest is added, round by round, where the reproduction
    is worst; then the labels are optimised together.

    Args:
        disparity: the map, any unit, finite.
        k: number of points.
        step: jumps larger than this are cut; by default 2 % of the map's range.
        iterations: of Adam on the labels at the end.

    Returns:
        The encoding.

    Raises:
        ValueError: `k` is below 1 or above the number of pixels, or the map is not finite.

    Source:
        Thesis 1.1.1 and 7.2.3, completeness: what the model can represent at all.
    """
    if not 1 <= k <= disparity.size:
        raise ValueError(f"`k` must be from 1 to the {disparity.size} pixels there are, got {k}.")
    if not bool(jnp.isfinite(disparity).all()):
        raise ValueError("`disparity` must be finite, got NaN or infinity.")
    dtype = disparity.dtype
    low, high = jnp.min(disparity), jnp.max(disparity)
    spread = jnp.where(high > low, high - low, 1)
    cut = _cuts(disparity, 0.02 * spread if step is None else jnp.asarray(step).astype(dtype))
    params, flat, valid = _params(dtype), disparity.ravel(), np.zeros(k, bool)

    def current(taken: np.ndarray) -> tuple[DepthModel, Array]:
        pixel = np.zeros(k, np.int32)
        chosen = np.flatnonzero(taken)
        pixel[: chosen.size] = chosen
        valid[:] = np.arange(k) < chosen.size
        model = _model(jnp.asarray(pixel), flat[jnp.asarray(pixel)], jnp.asarray(valid), cut)
        return model, compiled_render(model, params, _SIZES).disparity

    taken = _first_points(cut.shape[0], cut.shape[1], max(k // 2, 1))
    for later in range(_ROUNDS):
        missing = k - int(taken.sum())
        if missing == 0:
            break
        last = later == _ROUNDS - 1
        error = jnp.abs(current(taken)[1] - disparity)
        error = jnp.where(jnp.asarray(taken.reshape(disparity.shape)), -1, error)
        # Blocks keep points apart, so that they do not crowd; the last ones may.
        xy, value = worst_pixels(
            error, missing if last else -(-missing // (_ROUNDS - later)), block=1 if last else 2
        )
        xy = np.asarray(xy)[np.asarray(value) >= 0]
        taken[xy[:, 1] * disparity.shape[1] + xy[:, 0]] = True
    model, reproduced = current(taken)
    if iterations:
        known = jnp.ones(disparity.shape, bool)
        weights = SupervisedWeights(square=jnp.asarray(0.0))
        goal = Supervised(disparity, known, unlimited(model), params, weights, _SIZES)
        rate = jnp.asarray([0, 0.002, 0, 0], dtype) * spread
        state = begin(model, reproduced, key=jax.random.key(0))
        routine = all_at_once(Rates(rate=rate), iterations=iterations)
        model = advance(state, routine, goal)[0].best
    top = jnp.maximum(high, jnp.max(model.disparity))
    bottom = jnp.minimum(low, jnp.min(model.disparity))
    spread = jnp.where(top > bottom, top - bottom, 1)
    level = jnp.round((model.disparity - bottom) / spread * 65535).astype(jnp.int32)
    pixel = jnp.asarray(np.flatnonzero(taken).astype(np.int32))
    return Encoding(pixel, level, cut, bottom, bottom + spread)


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
    scale = (encoding.high - encoding.low) / 65535
    label = encoding.low + encoding.label.astype(dtype) * scale
    valid = jnp.ones(label.shape, bool)
    model = _model(encoding.pixel, label, valid, encoding.cut)
    return compiled_render(model, _params(dtype), _SIZES).disparity
