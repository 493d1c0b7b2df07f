"""The disparity range of a scene, measured if it is unknown."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mvedge_jax._checks import untraced
from mvedge_jax._compiler import lean_jit
from mvedge_jax._crosshair import crosshair
from mvedge_jax._params import cast
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import Noise
from mvedge_jax.photometry.brightness import expose, rough_brightness
from mvedge_jax.photometry.matching import Matching, best_match

from ._candidates import contrast


@dataclass(frozen=True)
class RangeSearch:
    """Parameters of the search for the disparity range, on the host.

    Attributes:
        step: spacing of the disparities tried, px per view step of the shrunk views.
        window: half the width of the windows in which views are compared, px.
        sure: largest accepted cost, of 2.
        widest: magnitude up to which the range is doubled, px per view step. Beyond this a scene
            point leaves most views; no data set is wider.
        grainy: noise in the shrunk views, gray levels of 100, above which single pixels are not
            trusted.
        tail: share of the pixels beyond either end.
        false: increase of that share per gray level of noise beyond `grainy`, for false matches.
    """

    step: float = 0.1
    window: int = 2
    sure: float = 1.0
    widest: float = 12.0
    grainy: float = 0.4
    tail: float = 0.002
    false: float = 0.016


@lean_jit
def _coarse(
    light_field: LightField, disparities: Array, noise: Noise, *, window: int
) -> tuple[Array, ...]:
    """Best disparity, its cost, and the contrast of the center view, per pixel."""
    lab = srgb_to_lab(light_field.center_view)
    params = cast(Matching(), lab.dtype)
    planes = jnp.moveaxis(lab, -1, 0)
    best = best_match(
        crosshair(light_field), planes, disparities, params, window=window, noise=noise
    )
    return *best, contrast(lab).max(0)


def disparity_range(
    light_field: LightField, *, start: float = 4.0, search: RangeSearch | None = None
) -> tuple[float, float]:
    """Measures the disparity range of a scene from the crosshair of views, on the host.

    The cost of `hypotheses` is computed in shrunk views of equal brightness, over a wide range,
    which is doubled while the best disparities lie at its ends. Textureless pixels and likely
    noise are ignored; the margin covers the loss by shrinking.

    Args:
        light_field: its own `disparity_range` is ignored.
        start: first magnitude tried, px per view step.
        search: parameters; None for the defaults.

    Returns:
        Lowest and highest disparity, px per view step, with a margin.

    Raises:
        TypeError: if the views are traced.
        ValueError: if they show no edges at all to measure.

    Example:
        >>> import jax.numpy as jnp
        >>> stripes = jnp.tile(jnp.arange(64.0) % 16 / 16, (3, 3, 64, 1))[..., None]
        >>> low, high = disparity_range(LightField(jnp.tile(stripes, 3)))
        >>> low < 0 < high
        True
    """
    untraced("light_field", light_field.views)
    search = RangeSearch() if search is None else search
    side = min(light_field.views.shape[2:4])
    # 128 px keep fine structure measurable; smaller views are searched as they are.
    factor = max(1, side // 128)
    light_field = light_field.bare()
    exposure, noise = rough_brightness(light_field)
    coarse = expose(light_field.downsample(factor), exposure)
    # Gray levels of 100 in the shrunk views; a fifth to a half of the noise of colors in Lab.
    grain = 100 / factor * float(noise.alpha * noise.deviation)
    noise = Noise.of(noise.deviation / factor)
    reach = start
    while True:
        count = int(np.ceil(reach / factor / search.step))
        tried = search.step * jnp.arange(-count, count + 1, dtype=coarse.views.dtype)
        disparities, cost, slope = map(
            np.asarray, _coarse(coarse, tried, noise, window=search.window)
        )
        edge = slope > 1 + 6 * grain
        if not edge.any():
            edge = slope > 1
        # Without contrast the outermost disparities win by chance: leave these pixels out.
        sure = edge & (cost < search.sure)
        if not edge.any():
            raise ValueError(
                "`light_field` shows no edges from which to measure the disparity range; give "
                "`disparity_range`."
            )
        if grain > search.grainy:
            # Noise in single pixels would make the tails.
            around = np.pad(disparities, 2, mode="edge")
            windows = np.lib.stride_tricks.sliding_window_view(around, (5, 5))
            disparities = np.median(windows, axis=(2, 3))
        values = factor * disparities[sure if sure.sum() > 0.05 * edge.sum() else edge]
        tail = search.tail + search.false * max(grain - search.grainy, 0)
        low, high = np.quantile(values, [tail, 1 - tail])
        wide = factor * search.step * count
        outermost = (np.abs(values) > 0.95 * wide).mean()
        if outermost < 0.01 or 2 * reach > search.widest:
            break
        reach *= 2
    margin = 0.1 + 0.05 * (high - low)
    return float(low - margin), float(high + margin)


def scene_range(light_field: LightField) -> tuple[float, float]:
    """The disparity range of a light field: its own if it has one, else a measured one.

    Args:
        light_field: the views.

    Returns:
        Lowest and highest disparity, px per view step, as numbers of the host.

    Raises:
        TypeError: the range is traced, or is unknown and the views are.
        ValueError: the range is unknown, and the views show no edges to measure it from.

    Example:
        >>> import jax.numpy as jnp
        >>> views = jnp.zeros((3, 3, 16, 16, 3))
        >>> scene_range(LightField(views, disparity_range=(-1.5, 2.0)))
        (-1.5, 2.0)
    """
    known = light_field.disparity_range
    untraced("light_field.disparity_range", known)
    # On the host even within a `jit` that closes over the light field.
    low, high = disparity_range(light_field) if known is None else np.asarray(known)
    return float(low), float(high)
