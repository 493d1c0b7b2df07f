"""Depth tile by tile, as if of the whole image."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from mvedge_jax._compiler import lean_jit
from mvedge_jax._paths import replaced
from mvedge_jax._stored_views import StoredViews
from mvedge_jax.depth import DepthResult, DepthStats, EdgeDepth, estimate_depth
from mvedge_jax.edges import scene_range
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import Calibrate
from mvedge_jax.photometry.brightness import Exposure, GridViews, Known, measure_noise
from mvedge_jax.photometry.matching import between_views_variance

from ._layout import Tile, Tiling

# Tiles in which noise is looked for between views; of several, the middle one counts.
_SAMPLES = 5
_MAPS = ("disparity", "error", "depth_edge")


def depth_in_tiles(
    views: StoredViews | LightField,
    *,
    model: EdgeDepth | None = None,
    tiling: Tiling | None = None,
    progress: Callable[[int, int], None] | None = None,
    key: PRNGKeyArray | None = None,
) -> DepthResult:
    """Depth of an image that is larger than the memory allows.

    Exposure, gains, vignettes and noise are measured once, for the whole image. Then each tile is
    a light field of its own; tiles overlap, and the map is cut in the middle of what they share.
    All run one compiled program. On the host: neither differentiable nor traced. Where a surface
    is plain over more than the overlap, the map may have a seam.

    Args:
        views: the crosshair; `datasets.stored` reads one that takes little memory.
        model: for light fields of the shape of a tile, without `all_views`; None for `"full"`.
        tiling: size and overlap of the tiles; None for tiles of 768 px.
        progress: called with the number of tiles that are done and that there are.
        key: of parts that draw; every tile has one of its own.

    Returns:
        See `DepthResult`; points without empty slots. Of `stats`, `valid` counts the
        points of the map; other counts are sums over tiles, iterations the most of any tile.

    Raises:
        ValueError: the model measures labels in all views, or tiles do not overlap rightly.

    Example:
        >>> field = LightField(jnp.full((3, 3, 40, 24, 3), 0.5), disparity_range=(-1.0, 1.0))
        >>> depth_in_tiles(field, tiling=Tiling(side=24, overlap=8)).disparity.shape
        (40, 24)
    """
    stored = StoredViews.of(views) if isinstance(views, LightField) else views
    tiles = (Tiling() if tiling is None else tiling).of(*stored.shape[2:])
    stored = with_measured_range(stored)
    if model is None:
        model = EdgeDepth.for_light_field(stored.window(tiles[0].window))
    elif model.measurement is not None and model.measurement.views == "all":
        raise ValueError("`model` measures labels in all views; tiles have those of the crosshair.")
    known = None
    if isinstance(model.calibration, Calibrate):
        known = _measured(stored, model.calibration, model.searched, tiles)
    results = []
    for index, tile in enumerate(tiles):
        own = None if key is None else jax.random.fold_in(key, index)
        results.append(_core_of(_of_tile(stored, model, known, tile, own), tile))
        if progress is not None:
            progress(index + 1, len(tiles))
    whole = _joined(tiles, results, stored.shape[2:])
    if known is not None:
        stats = whole.stats._replace(exposure=known.exposure, noise=known.noise)
        whole = whole._replace(stats=stats)
    return jax.tree.map(jnp.asarray, whole)


def with_measured_range(stored: StoredViews) -> StoredViews:
    """The same with a disparity range, measured in small pictures if it is not known.

    Args:
        stored: the views.

    Returns:
        Views of which every window has one range, so that all share a model. A ValueError if the
        range is unknown, and the views show no edges to measure it from.
    """
    if stored.disparity_range is not None:
        return stored
    small, factor = stored.shrunk()
    low, high = scene_range(small)
    return dataclasses.replace(stored, disparity_range=(factor * low, factor * high))


def _of_tile(
    stored: StoredViews, model: EdgeDepth, known: Known | None, tile: Tile, key: PRNGKeyArray | None
) -> DepthResult:
    """The depth of a tile, on the host."""
    window = tile.window
    if known is not None:
        whole, size = stored.shape[2:], (window.height, window.width)
        exposure = known.exposure.within(window.top, window.left, size, whole)
        model = model.replace({"calibration.known": known._replace(exposure=exposure)})
    return jax.device_get(estimate_depth(stored.window(window).bare(), model, key=key))


def _measured(
    stored: StoredViews,
    calibration: Calibrate,
    searched: tuple[float, float],
    tiles: Sequence[Tile],
) -> Known:
    """Brightness of the views, from small pictures; noise, of which these have less, from tiles."""
    small, factor = stored.shrunk()
    low, high = (limit / factor for limit in searched)
    fewer = max(-(-calibration.hypotheses // factor), 2)
    rough = replaced(calibration, {"hypotheses": fewer})
    exposure = _exposure(small.bare(), rough, (low, high))
    tried = jnp.linspace(*searched, calibration.hypotheses, dtype=jnp.float32)
    params = calibration.brightness.noise
    some = np.unique(np.linspace(0, len(tiles) - 1, _SAMPLES).round().astype(int))
    fields = (stored.window(tiles[index].window).bare() for index in some)
    between = [_between(field, exposure, tried, params.finer) for field in fields]
    center = exposure.scale * jnp.moveaxis(jnp.asarray(stored.center_view), -1, 0)
    middle = jnp.median(jnp.stack(between))
    return Known(exposure, measure_noise(center, exposure.scale, between=middle, params=params))


@lean_jit
def _exposure(
    light_field: LightField, calibration: Calibrate, searched: tuple[float, float]
) -> Exposure:
    return calibration(light_field, searched).exposure


@lean_jit
def _between(
    light_field: LightField, exposure: Exposure, tried: Float[Array, " d"], finer: int
) -> Float[Array, ""]:
    """Variance that the best disparities leave between views, vignettes or not."""
    views = GridViews(light_field).exposed(exposure._replace(vignette=None))
    return between_views_variance(views, tried, finer=finer)


def _core_of(result: DepthResult, tile: Tile) -> DepthResult:
    """What counts of a tile: maps of its core, and points there at their place in the image."""
    window, core = tile
    inner = core._replace(top=core.top - window.top, left=core.left - window.left)
    own, surface = result.points, result.surface
    xy = own.xy + np.asarray([window.left, window.top], own.xy.dtype)
    place = np.floor(xy + 0.5) - (core.left, core.top)
    keep = own.valid & (place >= 0).all(-1) & (place < (core.width, core.height)).all(-1)

    def kept(values: Any) -> np.ndarray:
        return np.asarray(values)[keep]

    sides: Any = surface._replace(length=None)
    return result._replace(
        **{name: inner.of(np.asarray(getattr(result, name))).copy() for name in _MAPS},
        points=jax.tree.map(kept, eqx.tree_at(lambda points: points.xy, own, xy)),
        surface=jax.tree.map(kept, sides)._replace(length=surface.length),
    )


def _joined(
    tiles: Sequence[Tile], results: Sequence[DepthResult], shape: tuple[int, int]
) -> DepthResult:
    """The maps and the points of all tiles."""
    maps = {name: np.empty(shape, np.float32) for name in _MAPS}
    for tile, result in zip(tiles, results, strict=True):
        for name, image in maps.items():
            tile.core.of(image)[...] = getattr(result, name)
    length = results[0].surface.length
    parts = [(result.points, result.surface._replace(length=None)) for result in results]
    points, sides = jax.tree.map(lambda *each: np.concatenate(each), *parts)
    stats = _summed([result.stats for result in results], len(points.valid))
    whole = {name: jnp.asarray(image) for name, image in maps.items()}
    return DepthResult(**whole, points=points, surface=sides._replace(length=length), stats=stats)


def _summed(stats: Sequence[DepthStats], valid: int) -> DepthStats:
    """Statistics of all tiles."""

    def total(*counts: Any) -> Array:
        return jnp.sum(jnp.stack(counts), axis=0)

    edges = jax.tree.map(total, *(of.edges for of in stats))
    return stats[0]._replace(
        edges=eqx.tree_at(lambda of: of.valid, edges, np.asarray(valid)),
        points=total(*(of.points for of in stats)),
        sided=total(*(of.sided for of in stats)),
        iterations=jnp.max(jnp.stack([of.iterations for of in stats]), axis=0),
        converged=jnp.all(jnp.stack([of.converged for of in stats])),
        sound=jnp.all(jnp.stack([of.sound for of in stats])),
    )
