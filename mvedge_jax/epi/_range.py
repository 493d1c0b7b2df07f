"""The disparity range of a scene, measured where it is not given."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..color import srgb_to_gray, srgb_to_lab
from ..lightfield import LightField
from ..photometry import Exposure, Noise, expose, measure_noise, rough_exposure
from ._bank import bank_radius, prewitt_bank
from ._candidates import contrast
from ._search import Maps, search

_STEP = 0.1
# Beyond this a scene point leaves most views; nothing in the literature is wider.
_WIDEST = 12.0
# Noise in the shrunk views, grey levels of 100, from which single pixels are not believed.
_GRAINY = 0.4


@eqx.filter_jit
def _brightness(light_field: LightField) -> tuple[Exposure, Noise]:
    exposure = rough_exposure(light_field)
    centre = jnp.moveaxis(light_field.centre_view, -1, 0)
    return exposure, measure_noise(exposure.scale * centre, exposure.scale)


@eqx.filter_jit
def _coarse(
    across: Array, down: Array, disparity: Array, saturation: Array, radius: int, tile: int
) -> Maps:
    down = jnp.swapaxes(down, 1, 2)
    banks = (
        prewitt_bank(disparity, across.shape[0], radius),
        prewitt_bank(disparity, down.shape[0], radius),
    )
    return search(
        (srgb_to_lab(across), srgb_to_lab(down)),
        (100 * srgb_to_gray(across), 100 * srgb_to_gray(down)),
        banks,
        saturation,
        window=5,
        tile=tile,
    )


def disparity_range(light_field: LightField, *, start: float = 4.0) -> tuple[float, float]:
    """Measures the disparity range of a scene from the crosshair of views, on the host.

    The search of `multiview_edges` runs on shrunk views, their brightness made alike, over a wide
    range, which is doubled as long as the best disparities lie at its ends. Textureless pixels, and
    what the noise may have drawn, have no say; the margin covers what shrinking loses.

    Args:
        light_field: a `disparity_range` it may have is not looked at.
        start: first magnitude tried, px per view step.

    Returns:
        Lowest and highest disparity, px per view step, with a margin.

    Raises:
        ValueError: if the views show no edges at all to measure.

    Example:
        >>> import jax.numpy as jnp
        >>> stripes = jnp.tile(jnp.arange(64.0) % 16 / 16, (3, 3, 64, 1))[..., None]
        >>> low, high = disparity_range(LightField(jnp.tile(stripes, 3)))
        >>> low < 0 < high
        True
    """
    side = min(light_field.views.shape[2:4])
    # 128 px keep fine structure measurable; smaller views are searched as they are.
    factor = max(1, side // 128)
    vc, uc = light_field.centre
    light_field = light_field.without_truth()
    exposure, noise = _brightness(light_field)
    coarse = expose(light_field.downsample(factor), exposure)
    across, down = coarse.views[vc], coarse.views[:, uc]
    # Grey levels of 100 in the shrunk views; a fifth to a half of what colours in Lab show of it.
    grain = 100 / factor * float(noise.alpha * noise.deviation)
    saturation = jnp.asarray(0.2 + 1.8 * grain**2, across.dtype)
    slope = np.asarray(contrast(srgb_to_lab(coarse.centre_view))).max(0)
    reach = start
    while True:
        count = int(np.ceil(reach / factor / _STEP))
        disparity = _STEP * jnp.arange(-count, count + 1, dtype=across.dtype)
        radius = bank_radius(_STEP * count, max(across.shape[0], down.shape[0]))
        tile = min(64, -(-max(across.shape[1:3]) // 8) * 8)
        maps = jax.tree.map(np.asarray, _coarse(across, down, disparity, saturation, radius, tile))
        # Filters of a wrong disparity respond beside an edge, too, where the centre view has none.
        strength = maps.strength.max(0)
        edge = (strength > 1 + 3 * grain) & (slope > 1 + 6 * grain)
        if not edge.any():
            edge = (strength > 1) & (slope > 1)
        # The end filters win by accident in places without contrast or depth: leave those out.
        sure = edge & (maps.cost < 0.6)
        if not edge.any():
            raise ValueError(
                "`light_field` shows no edges from which to measure the disparity range; give "
                "`disparity_range`."
            )
        disparities = maps.disparity
        if grain > _GRAINY:
            # What noise adds to single pixels would make the tails.
            around = np.pad(disparities, 2, mode="edge")
            windows = np.lib.stride_tricks.sliding_window_view(around, (5, 5))
            disparities = np.median(windows, axis=(2, 3))
        values = factor * disparities[sure if sure.sum() > 0.05 * edge.sum() else edge]
        low, high = np.quantile(values, [0.002, 0.998])
        wide = factor * _STEP * count
        outermost = (np.abs(values) > 0.95 * wide).mean()
        if outermost < 0.01 or 2 * reach > _WIDEST:
            break
        reach *= 2
    margin = 0.1 + 0.05 * (high - low)
    return float(low - margin), float(high + margin)


def scene_range(light_field: LightField) -> tuple[float, float]:
    """The disparity range of a light field: its own where it knows one, and a measured one else.

    Args:
        light_field: the views.

    Returns:
        Lowest and highest disparity, px per view step, as numbers of the host.

    Raises:
        ValueError: the range is unknown, and the views show no edges to measure it from.

    Example:
        >>> import jax.numpy as jnp
        >>> views = jnp.zeros((3, 3, 16, 16, 3))
        >>> scene_range(LightField(views, disparity_range=(-1.5, 2.0)))
        (-1.5, 2.0)
    """
    known = light_field.disparity_range
    low, high = disparity_range(light_field) if known is None else known
    return float(low), float(high)
