"""Rendering: a grid of views with exact disparity and ids."""

import concurrent.futures
import os
from collections.abc import Callable, Sequence
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from mvedge_jax._positions import check_positions
from mvedge_jax.lightfield import GroundTruth, LightField

from ._trace import Mode, Pinhole, mode_of, sees, trace_view
from .world import Scene


def trace_views(
    scene: Scene,
    pinholes: list[Pinhole],
    mode: Mode,
    progress: Callable[[int, int], None] | None,
    key: PRNGKeyArray,
    numbers: Sequence[int] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Traces views on all cores, straight into arrays: one view per core is in flight.

    A view's noise is that of its number; by default views are counted.
    """
    numbers = range(len(pinholes)) if numbers is None else numbers
    dtype = np.dtype(scene.world.solids.center.dtype)
    count = len(pinholes)
    images = np.empty((count, *mode.size, 3), dtype)
    depth = np.empty((count, *mode.size), dtype)
    ids = np.empty((count, *mode.size), np.int32)

    def trace(k: int) -> None:
        view = np.asarray(numbers[k], np.int32)
        result = trace_view(scene.world, scene.sensor, pinholes[k], key, view, mode=mode)
        images[k], depth[k], ids[k] = (np.asarray(part) for part in result)

    trace(0)  # compiles
    if progress is not None:
        progress(1, count)
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        try:
            tasks = pool.map(trace, range(1, count))
            for done, _ in enumerate(tasks, start=2):
                if progress is not None:
                    progress(done, count)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return images, depth, ids


def check_shape(shape: tuple[int, ...], names: str) -> None:
    if len(shape) != len(names.split(", ")) or not all(
        isinstance(n, int | np.integer) and n > 0 for n in shape
    ):
        raise ValueError(f"`shape` must be positive integers ({names}), got {shape}.")


def check_samples(samples: int) -> None:
    if not 1 <= samples <= 16:
        raise ValueError(f"`samples` must be between 1 and 16 per side of a pixel, got {samples}.")


def check_grid(shape: tuple[int, ...], samples: int) -> tuple[int, int, int, int]:
    """Refuses what `render` cannot; the shape in Python's integers."""
    check_shape(shape, "view rows, view columns, height, width")
    check_samples(samples)
    rows, columns, height, width = (int(n) for n in shape)
    if rows % 2 == 0 or columns % 2 == 0:
        raise ValueError(
            f"`shape` must have odd numbers of view rows and columns, got {rows}x{columns}."
        )
    return rows, columns, height, width


def grid_pinhole(
    scene: Scene, shape: tuple[int, int, int, int], position: tuple[float, float]
) -> Pinhole:
    """The camera of one view: parallel to the center's, its sensor shifted."""
    _, _, height, width = shape
    dtype = np.dtype(scene.world.solids.center.dtype)
    focal, gain, focus = (float(x) for x in (scene.rig.focal, scene.rig.gain, scene.rig.focus))
    focal_px = focal * max(height, width)
    du, dv = position
    baseline = gain / focal_px
    right, down = np.asarray(scene.rig.place)
    return Pinhole(
        origin=np.asarray([right + du * baseline, down + dv * baseline, 0.0], dtype),
        rotation=np.eye(3, dtype=dtype),
        focal=np.asarray([focal_px, focal_px], dtype),
        principal=np.asarray(
            [(width - 1) / 2 + du * gain / focus, (height - 1) / 2 + dv * gain / focus], dtype
        ),
    )


def regular(shape: tuple[int, int, int, int], v: int, u: int) -> tuple[float, float]:
    """The position of a view of a regular grid."""
    return float(u - shape[1] // 2), float(v - shape[0] // 2)


def render(
    scene: Scene,
    *,
    shape: tuple[int, int, int, int],
    positions: Float[Array, "v u 2"] | np.ndarray | None = None,
    views: Literal["all", "crosshair"] = "all",
    samples: int = 3,
    progress: Callable[[int, int], None] | None = None,
    key: PRNGKeyArray,
) -> LightField:
    """Renders a light field with exact disparity and object ids for every view.

    The scene's disparities are in px per view step whatever the size: a smaller picture shows the
    same scene with a wider grid of cameras relative to it.

    Args:
        scene: see `scene` for those with a name and `make_world` for your own.
        shape: view rows, view columns (both odd), height and width in px.
        positions: of the views, see `LightField`; None for a regular grid.
        views: `"crosshair"` renders the center row and column; the other views are missing, and
            the truth is that of the center view.
        samples: the image averages `samples**2` rays per pixel, spread like a tent of half width
            1 px; the ground truth is that of the pixel's center.
        progress: called with the number of views that are done and that there are.
        key: draws the sensor's noise; the same key gives the same pictures.

    Returns:
        A light field in the dtype of the scene, with the full `truth`, the exact `camera` and the
        disparity range. Object id 0 is the sky, whose disparity is that of infinity. Not
        differentiable.

    Raises:
        ValueError: a size, positions or `samples` are out of range, or view rows or columns even.

    Example:
        >>> import jax
        >>> from mvedge_jax.datasets import synthetic
        >>> light_field = synthetic.render(
        ...     synthetic.scene("crossing"), shape=(3, 3, 16, 16), samples=1, key=jax.random.key(0)
        ... )
        >>> light_field.views.shape, light_field.truth.view_disparity.shape
        ((3, 3, 16, 16, 3), (3, 3, 16, 16))
    """
    shape = check_grid(shape, samples)
    rows, columns, height, width = shape
    if views not in ("all", "crosshair"):
        raise ValueError(f"`views` must be 'all' or 'crosshair', got {views!r}.")
    vc, uc = rows // 2, columns // 2
    available = np.full((rows, columns), views == "all")
    available[vc], available[:, uc] = True, True
    rendered = np.argwhere(available).tolist()
    places = [regular(shape, v, u) for v, u in rendered]
    if positions is not None:
        given = np.asarray(positions, float)
        if given.shape != (rows, columns, 2):
            raise ValueError(
                f"`positions` must have the shape {(rows, columns, 2)}, got {given.shape}."
            )
        check_positions(given)
        places = [(x, y) for x, y in given[available].tolist()]
    pinholes = [grid_pinhole(scene, shape, place) for place in places]
    mode = mode_of(scene, (height, width), samples)
    numbers = np.flatnonzero(available).tolist()
    images, depth, ids = trace_views(scene, pinholes, mode, progress, key, numbers)
    # Moved into JAX one by one: what is held twice is one array at a time.
    shown = _on_grid(images, available)
    del images
    gain, focus = float(scene.rig.gain), float(scene.rig.focus)
    np.divide(gain, depth, out=depth)
    np.subtract(depth, gain / focus, out=depth)
    disparity = _on_grid(depth, available)
    del depth
    object_ids = _on_grid(ids, available)
    every = available.all()
    return LightField(
        shown,
        available=available,
        positions=positions,
        disparity_range=scene.disparity_range,
        truth=GroundTruth(
            disparity=disparity[vc, uc],
            valid=jnp.ones((height, width), bool),
            object_ids=object_ids[vc, uc],
            view_disparity=disparity if every else None,
            view_ids=object_ids if every else None,
        ),
        camera=scene.rig.camera(height, width),
        name=scene.name,
    )


def _on_grid(rendered: np.ndarray, available: np.ndarray) -> Array:
    """Views at their places in the grid, 0 where a view is missing."""
    if available.all():
        return jnp.asarray(rendered.reshape(*available.shape, *rendered.shape[1:]))
    placed = np.zeros((*available.shape, *rendered.shape[1:]), rendered.dtype)
    placed[available] = rendered
    return jnp.asarray(placed)


def visibility(
    scene: Scene,
    *,
    shape: tuple[int, int, int, int],
    source: tuple[int, int],
    target: tuple[int, int],
) -> Bool[Array, "y x"]:
    """Which pixel centers of one view another view sees too: the exact occlusion mask.

    Args:
        scene: what was rendered.
        shape: as for `render`.
        source: `(v, u)` of the view of a regular grid whose pixels are asked about.
        target: `(v, u)` of the view that may see them.

    Returns:
        True where the surface point is inside the target's frame and nothing is in front of it.

    Raises:
        ValueError: if a view is outside of the grid.
    """
    check_shape(shape, "view rows, view columns, height, width")
    for name, (v, u) in (("source", source), ("target", target)):
        if not (0 <= v < shape[0] and 0 <= u < shape[1]):
            raise ValueError(
                f"`{name}` must be a view of the {shape[0]}x{shape[1]} grid, got ({v}, {u})."
            )
    first, second = (grid_pinhole(scene, shape, regular(shape, *v)) for v in (source, target))
    return sees(scene.world, first, second, size=(int(shape[2]), int(shape[3])))
