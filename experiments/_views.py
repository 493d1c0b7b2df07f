"""For the experiments on every view: scenes with truth in all views, regions, consistency."""

from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from _report import shared_data
from _scenes import find_scene, stored
from jax import lax

from mvedge_jax import lean_jit
from mvedge_jax.lightfield import GroundTruth, LightField
from mvedge_jax.metrics import ViewConsistency
from mvedge_jax.metrics.depth import bad_pixels, mse

# Disparities that differ by more than this, px, belong to two surfaces.
SAME = 0.1
BAD = 0.07


def scene(name: str, size: int) -> LightField:
    """A light field by its path, its name in the development data, or that of a synthetic one.

    Traced scenes keep the truth of all their views in one `truth.npz`, which is read, too.
    """
    data = shared_data()
    light_field, place = find_scene(name, data, size=size), stored(name, data)
    extra = place / "truth.npz" if place is not None else None
    return with_truth(light_field, extra) if extra and extra.is_file() else light_field


def with_truth(light_field: LightField, file: Path) -> LightField:
    """The light field with the disparity of all views from a traced scene's file."""
    with np.load(file) as stored:
        disparity = stored["offset"] + stored["scale"] * stored["disparity"].astype(np.float32)
    known = light_field.truth
    if known is None or disparity.shape != light_field.views.shape[:4]:
        raise ValueError(
            f"{file} has maps of the shape {disparity.shape}, expected that of the views, "
            f"{light_field.views.shape[:4]}, beside a center map."
        )
    every = jnp.asarray(disparity, light_field.views.dtype)
    truth = GroundTruth(known.disparity, known.valid, known.object_ids, every, None)
    return eqx.tree_at(lambda field: field.truth, light_field, truth)


class Regions(NamedTuple):
    """Pixels of every view whose true surface the center view does not show, `[v, u, y, x]`.

    Attributes:
        covered: something nearer is there in the center view.
        outside: beyond its frame.
        seam: something farther is there: the pixel lies between two of the center view's.
    """

    covered: np.ndarray
    outside: np.ndarray
    seam: np.ndarray

    @property
    def hidden(self) -> np.ndarray:
        """All three."""
        return self.covered | self.outside | self.seam


def regions(truth: np.ndarray) -> Regions:
    """Finds what the center view does not show by the true maps `[v, u, y, x]`.

    A pixel of view (v, u) with the true disparity d lies at `(x, y) + (u - u_c, v - v_c) d` in the
    center view; the nearest pixel there tells.
    """
    rows, columns, height, width = truth.shape
    center = truth[rows // 2, columns // 2]
    y, x = np.mgrid[:height, :width]
    found = Regions(*(np.zeros(truth.shape, bool) for _ in range(3)))
    for v, u in np.ndindex(rows, columns):
        if (v, u) == (rows // 2, columns // 2):
            continue
        d = truth[v, u]
        b = np.floor(y + (v - rows // 2) * d + 0.5).astype(int)
        a = np.floor(x + (u - columns // 2) * d + 0.5).astype(int)
        inside = (a >= 0) & (a < width) & (b >= 0) & (b < height)
        there = center[b.clip(0, height - 1), a.clip(0, width - 1)]
        found.outside[v, u] = ~inside
        found.covered[v, u] = inside & (there > d + SAME)
        found.seam[v, u] = inside & (there < d - SAME)
    return found


def scores(maps: jax.Array, truth: jax.Array, known: Regions) -> dict[str, float]:
    """MSE x 100 and BP(.07): means over views, of corners, of hidden pixels, of the center.

    Hidden ones are pooled over the off-center views that have some: a mean over views.
    """
    rows, columns = truth.shape[:2]
    middle = (rows // 2, columns // 2)
    grid = list(np.ndindex(rows, columns))

    @lean_jit
    def pair(found: jax.Array, true: jax.Array, mask: jax.Array) -> jax.Array:
        return jnp.stack([mse(found, true, mask=mask), bad_pixels(found, true, BAD, mask=mask)])

    whole = jnp.ones(truth.shape[2:], bool)
    each = np.asarray([pair(maps[at], truth[at], whole) for at in grid])
    hidden = np.asarray([pair(maps[at], truth[at], jnp.asarray(known.hidden[at])) for at in grid])
    corners = [i for i, (v, u) in enumerate(grid) if v in (0, rows - 1) and u in (0, columns - 1)]
    off = [i for i, at in enumerate(grid) if at != middle]
    parts = {
        "center": each[grid.index(middle)],
        "mean": each.mean(0),
        "corners": each[corners].mean(0),
        "hidden": np.nanmean(hidden[off], 0) if known.hidden.any() else np.full(2, np.nan),
    }
    row = {f"{part} {kind}": float(v) for part, two in parts.items()
           for kind, v in zip(("MSE", "BP"), two, strict=True)}  # fmt: skip
    return {**row, "off/center": float(each[off, 0].mean() / max(parts["center"][0], 1e-12))}


def error_consistency(maps: jax.Array, truth: jax.Array, *, stride: int = 3) -> ViewConsistency:
    """Variance of map - truth between the views that truly see one surface point.

    Every point is a pixel of a view; other views are read at the nearest pixel, those whose truth
    there is that of the point see it. Rounding drops out: true maps score 0, and a map is charged
    for what the others do not get wrong as well.

    Args:
        maps: of all views, `[v, u, y, x]`, px per view step.
        truth: the same.
        stride: every which pixel is a point, along either axis.

    Returns:
        The variance, px², per view and in the mean, over points that two views or more see.
    """
    return ViewConsistency(*_consistency(maps - truth, truth, stride))


@lean_jit
def _consistency(error: jax.Array, truth: jax.Array, stride: int) -> Any:
    rows, columns, height, width = truth.shape
    grid = jnp.asarray(list(np.ndindex(rows, columns)), jnp.int32)
    y = jnp.arange(0, height, stride)[:, None]
    x = jnp.arange(0, width, stride)[None]
    flat = error.reshape(rows * columns, -1), truth.reshape(rows * columns, -1)

    def of_view(view: jax.Array) -> tuple[jax.Array, jax.Array]:
        own = truth[view[0], view[1], ::stride, ::stride]

        def add(state: tuple[jax.Array, ...], item: tuple[jax.Array, ...]):
            count, mean, squares = state
            wrong, true, other = item
            step = (view - other).astype(own.dtype)
            b = jnp.floor(y + step[0] * own + 0.5).astype(jnp.int32)
            a = jnp.floor(x + step[1] * own + 0.5).astype(jnp.int32)
            inside = (a >= 0) & (a < width) & (b >= 0) & (b < height)
            index = jnp.where(inside, b * width + a, 0)
            sees = inside & (jnp.abs(true[index] - own) < SAME)
            value = jnp.where(sees, wrong[index], mean)
            count = count + sees
            delta = value - mean
            mean = mean + delta / jnp.maximum(count, 1)
            return (count, mean, squares + delta * (value - mean)), None

        start = (jnp.zeros(own.shape, jnp.int32), jnp.zeros_like(own), jnp.zeros_like(own))
        (count, _, squares), _ = lax.scan(add, start, (*flat, grid))
        shared = count >= 2
        total = jnp.sum(jnp.where(shared, squares / jnp.maximum(count, 1), 0))
        return total / jnp.maximum(jnp.sum(shared), 1), jnp.mean(shared)

    per_view, covered = (a.reshape(rows, columns) for a in lax.map(of_view, grid))
    return per_view, covered, jnp.mean(per_view)
