"""Rendering the crosshair of large views, one after the other and in 8 bits."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, PRNGKeyArray

from mvedge_jax._stored_views import StoredViews

from ._render import check_grid, grid_pinhole, regular
from ._trace import mode_of, trace_view
from .world import Scene


def render_stored(
    scene: Scene,
    *,
    shape: tuple[int, int, int, int],
    samples: int = 3,
    progress: Callable[[int, int], None] | None = None,
    key: PRNGKeyArray,
) -> tuple[StoredViews, Float[np.ndarray, "y x"]]:
    """Renders the centre row and the centre column of views, for depth in tiles.

    Pictures are those of `render`, rounded to 8 bits; no more than one view is held in floating
    point.

    Args:
        scene: as for `render`, as are all others.
        shape: view rows, view columns (both odd), height and width in px.
        samples: rays per pixel along each of its sides.
        progress: called with the number of views that are done and that there are.
        key: draws the sensor's noise.

    Returns:
        The views, and the true disparity of the centre view.

    Raises:
        ValueError: as `render`.

    Example:
        >>> import jax
        >>> from mvedge_jax.datasets import synthetic
        >>> from mvedge_jax.datasets.stored import render_stored
        >>> stored, truth = render_stored(
        ...     synthetic.scene("crossing"), shape=(3, 3, 16, 16), samples=1, key=jax.random.key(0)
        ... )
        >>> len(stored.planes), truth.shape
        (5, (16, 16))
    """
    rows, columns, height, width = check_grid(shape, samples)
    mode = mode_of(scene, (height, width), samples)
    gain, focus = float(scene.rig.gain), float(scene.rig.focus)
    centre = rows // 2, columns // 2
    cross = [
        (v, u) for v in range(rows) for u in range(columns) if centre[0] == v or centre[1] == u
    ]
    planes, truth = {}, np.empty((height, width), np.float32)
    for done, (v, u) in enumerate(cross, start=1):
        pinhole = grid_pinhole(scene, shape, regular(shape, v, u))
        number = np.asarray(v * columns + u, np.int32)
        image, depth, _ = trace_view(scene.world, scene.sensor, pinhole, key, number, mode=mode)
        planes[v, u] = np.round(255 * np.asarray(image)).astype(np.uint8)
        if (v, u) == centre:
            truth[...] = gain / np.asarray(depth) - gain / focus
        if progress is not None:
            progress(done, len(cross))
    low, high = (float(end) for end in scene.disparity_range)
    stored = StoredViews(
        planes,
        (rows, columns),
        disparity_range=(low, high),
        camera=scene.rig.camera(height, width),
        name=scene.name,
    )
    return stored, truth
