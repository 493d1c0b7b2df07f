"""Depth of an image that is read tile by tile."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from mvedge_jax._compiler import lean_jit
from mvedge_jax._paths import replaced
from mvedge_jax._stored_views import StoredViews, Window, blank
from mvedge_jax.depth import DepthResult, EdgeDepth
from mvedge_jax.depth.steps import (
    Labeled,
    Map,
    Turn,
    diffuse_measured,
    diffuse_points,
    finish,
    label_part,
    measure_part,
    turns_by_solve,
)
from mvedge_jax.edges import EdgePoints, Edges, scene_range
from mvedge_jax.edges.sides import SurfaceVectors
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import Calibrate, Noise
from mvedge_jax.photometry.brightness import (
    Exposure,
    GridViews,
    Known,
    NoiseModel,
    measure_noise,
)
from mvedge_jax.photometry.matching import between_views_variance

from ._layout import Tile, Tiling

# Tiles in whose middle noise is looked for between views, and up to how many px a side; of several
# values, the middle one counts.
_SAMPLES, _SIDE = 5, 512


def depth_in_tiles(
    views: StoredViews | LightField,
    *,
    model: EdgeDepth | None = None,
    tiling: Tiling | None = None,
    progress: Callable[[int, int], None] | None = None,
    key: PRNGKeyArray | None = None,
) -> DepthResult:
    """Depth of an image that is larger than the memory allows.

    Exposure, gains, vignettes and noise are measured once, for the whole image. Points are found,
    and labels measured, tile by tile; what they see of their surroundings lies within the overlap
    of the tiles. Labels are diffused through the whole image. On the host: neither differentiable
    nor traced.

    Args:
        views: the crosshair; `datasets.stored` reads one that takes little memory.
        model: for light fields of the shape of a tile, without `all_views`; None for `"full"`.
        tiling: size and overlap of the tiles; None for tiles of 768 px.
        progress: called with the number of steps that are done and that there are: every tile is
            read once, and once more for every diffusion of dense labels.
        key: of parts that draw; every tile has one of its own.

    Returns:
        See `DepthResult`; points without empty slots. Of `stats.edges`, `valid` counts the points
        of the map, and other counts are sums over tiles.

    Raises:
        ValueError: the model measures labels in all views, or tiles do not overlap rightly.
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
        known = _brightness(stored, model.calibration, model.searched, tiles)
    turns = [] if model.dense is None else turns_by_solve(model.refine, jnp.float32)
    steps = _Steps(stored, model, known, tiles, len(tiles) * (1 + len(turns)), progress)
    labeled, prepared, points, surface = steps.labeled(key)
    if model.dense is None:
        result = diffuse_points(jax.device_put(labeled), model)
    else:
        found = steps.refined(labeled, prepared, turns)
        result = finish(found, jax.device_put(labeled), model)
    edges = eqx.tree_at(lambda of: of.valid, result.stats.edges, np.asarray(len(points.valid)))
    sided = np.asarray(np.sum(points.valid & (surface.score != 0)))
    stats = result.stats._replace(edges=edges, sided=sided)
    whole = result._replace(points=points, surface=surface, stats=stats)
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


def _brightness(
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
    fields = (stored.window(_middle(tiles[index].window)).bare() for index in some)
    between = jnp.stack([_between(field, exposure, tried, params.finer) for field in fields])
    center = jnp.asarray(stored.center_view)
    return Known(exposure, _noise(center, exposure.scale, between, params))


def _middle(window: Window) -> Window:
    """The middle of a window."""
    top, left, height, width = window
    rows, columns = min(height, _SIDE), min(width, _SIDE)
    return Window(top + (height - rows) // 2, left + (width - columns) // 2, rows, columns)


@lean_jit
def _exposure(
    light_field: LightField, calibration: Calibrate, searched: tuple[float, float]
) -> Exposure:
    return calibration(light_field, searched).exposure


@lean_jit
def _noise(
    center: Float[Array, "y x c"],
    scale: Float[Array, ""],
    between: Float[Array, " t"],
    params: NoiseModel,
) -> Noise:
    bright = scale * jnp.moveaxis(center, -1, 0)
    return measure_noise(bright, scale, between=jnp.median(between), params=params)


@lean_jit
def _between(
    light_field: LightField, exposure: Exposure, tried: Float[Array, " d"], finer: int
) -> Float[Array, ""]:
    """Variance that the best disparities leave between views, vignettes or not."""
    views = GridViews(light_field).exposed(exposure._replace(vignette=None))
    return between_views_variance(views, tried, finer=finer)


@dataclasses.dataclass
class _Steps:
    """The steps of the chain over all tiles.

    Attributes:
        stored: the views.
        model: the chain.
        known: brightness and noise of the whole image; None if the chain measures none.
        tiles: all of them.
        total: number of visits to tiles.
        progress: called after every visit.
        done: number of visits so far.
    """

    stored: StoredViews
    model: EdgeDepth
    known: Known | None
    tiles: Sequence[Tile]
    total: int
    progress: Callable[[int, int], None] | None
    done: int = 0

    def labeled(
        self, key: PRNGKeyArray | None
    ) -> tuple[Labeled, list[Any], EdgePoints, SurfaceVectors]:
        """Labels without points, prepared views of every tile, points and surface vectors."""
        images, parts, kept, prepared = _Pasted(self.stored.shape[2:]), [], [], []
        part: Any = None
        for index, tile in enumerate(self._visits()):
            own = None if key is None else jax.random.fold_in(key, index)
            field = self.stored.window(tile.window).bare()
            part = label_part(field, self._model_of(tile), key=own)
            prepared.append(part.given.views)
            part = jax.device_get(part._replace(given=part.given._replace(views=None)))
            images.paste((part.given._replace(span=None), part.first), tile)
            kept.append(_points_of(part, tile, self.stored.shape[2:]))
            parts.append((part.edges.stats, part.iterations, part.sound))
        given, first = images.whole
        points, surface = jax.tree.map(lambda *each: np.concatenate(each), *kept)
        stats, iterations, fine = jax.tree.map(lambda *each: np.stack(each), *parts)
        stats = jax.tree.map(lambda count: count.sum(0), stats)
        length = part.surface.length
        nobody = jax.tree.map(lambda values: values[:0], (part.edges.points, _sides(part)))
        whole = part._replace(
            given=given._replace(span=part.given.span),
            first=first,
            edges=Edges(nobody[0], stats),
            surface=nobody[1]._replace(length=length),
            iterations=iterations.max(0),
            sound=fine.all(),
        )
        if self.known is not None:
            whole = whole._replace(noise=self.known.noise, exposure=self.known.exposure)
        return whole, prepared, points, surface._replace(length=length)

    def refined(self, labeled: Labeled, prepared: Sequence[Any], turns: Sequence[Turn]) -> Map:
        """The map of dense labels."""
        span, disparity = labeled.given.span, np.asarray(labeled.first)
        given, found, stats = labeled.given._replace(span=None), None, []
        for pair in turns:
            ends = jnp.full(2, disparity.min()), jnp.full(2, disparity.max())
            pair, images = pair._replace(ends=ends), _Pasted(self.stored.shape[2:])
            for tile, views in zip(self._visits(), prepared, strict=True):
                inside = partial(_inside, window=tile.window)
                own, start = jax.tree.map(jnp.asarray, jax.tree.map(inside, (given, disparity)))
                own = own._replace(span=span, views=views)
                images.paste(jax.device_get(measure_part(own, start, self.model, pair)), tile)
            found = diffuse_measured(jax.device_put(images.whole), self.model, span, pair)
            disparity = np.asarray(found.disparity)
            stats.append((found.iterations, found.converged))
        assert found is not None
        iterations, converged = jax.tree.map(lambda *each: jnp.stack(each), *stats)
        return found._replace(iterations=iterations, converged=jnp.all(converged))

    def _visits(self) -> Iterator[Tile]:
        """Every tile; counts those that are done."""
        for tile in self.tiles:
            yield tile
            self.done += 1
            if self.progress is not None:
                self.progress(self.done, self.total)

    def _model_of(self, tile: Tile) -> EdgeDepth:
        """The chain that knows the brightness of a tile."""
        if self.known is None:
            return self.model
        top, left, height, width = tile.window
        exposure = self.known.exposure.within(top, left, (height, width), self.stored.shape[2:])
        return self.model.replace({"calibration.known": self.known._replace(exposure=exposure)})


class _Pasted:
    """Images put together of the cores of tiles.

    Attributes:
        whole: a pytree of images `[..., y, x]`; None before the first tile.
    """

    def __init__(self, shape: tuple[int, int]):
        self._shape = shape
        self.whole: Any = None

    def paste(self, part: Any, tile: Tile) -> None:
        """Copies the core of a tile's images."""
        window, core = tile
        inner = core._replace(top=core.top - window.top, left=core.left - window.left)
        if self.whole is None:
            self.whole = jax.tree.map(
                lambda image: blank((*image.shape[:-2], *self._shape), image.dtype), part
            )
        for whole, image in zip(jax.tree.leaves(self.whole), jax.tree.leaves(part), strict=True):
            _inside(whole, core)[...] = _inside(image, inner)


def _inside(image: np.ndarray, window: Window) -> np.ndarray:
    """A part of an image `[..., y, x]`."""
    top, left, height, width = window
    return image[..., top : top + height, left : left + width]


def _sides(part: Labeled) -> Any:
    """Surface vectors without what all points share."""
    return part.surface._replace(length=cast(Any, None))


def _points_of(part: Labeled, tile: Tile, shape: tuple[int, int]) -> tuple[EdgePoints, Any]:
    """The points of a tile's core at their place in the image, and their surface vectors."""
    height, width = shape
    window, core = tile
    own = part.edges.points
    xy = own.xy + np.asarray([window.left, window.top], own.xy.dtype)
    # Points may lie half a pixel beside the image.
    place = np.clip(np.floor(xy + 0.5), 0, (width - 1, height - 1)) - (core.left, core.top)
    keep = own.valid & (place >= 0).all(-1) & (place < (core.width, core.height)).all(-1)
    moved = eqx.tree_at(lambda points: points.xy, own, xy)
    return jax.tree.map(lambda values: np.asarray(values)[keep], (moved, _sides(part)))
