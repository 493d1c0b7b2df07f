"""Crossing lines: where a far edge passes behind a nearer surface, do both lines survive?

The definition, for the EPI of an image row:

- A *far edge* is a local maximum of the contrast along the row, of at least 2 Lab units over two
  pixels, in the view that the points are for, on a surface that covers two pixels to either side
  (next to another surface the contrast is that of the border). Its line must stay inside all views.
- A *crossing* is a far edge that a nearer surface hides in at least one view of the EPI and that
  is seen, one pixel to either side included, in at least three; and the border of that surface
  behind which it vanishes.
- It *survives* if there is a point in this row for either line: within 1.5 px of its position,
  and within 0.07 px per view of its disparity (the outlier threshold of the point stage).

Edges that the center view shows are looked for in the points of the center view. Those that it does
not show are looked for in the points of the view a quarter of the way in from either end, which
are found from half of the EPI's views: points belong to the view that shows them.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mvedge_jax.color import srgb_to_lab
from mvedge_jax.edges import EdgePoints
from mvedge_jax.lightfield import LightField


class Crossings(NamedTuple):
    """Pairs of lines that meet, in one view.

    Attributes:
        row: of the EPI.
        far: position and disparity of the far line [n 2].
        near: position and disparity of the border that hides it [n 2].
        views: in how many views of the EPI the far line is seen.
    """

    row: np.ndarray
    far: np.ndarray
    near: np.ndarray
    views: np.ndarray


def crossings(
    arm: np.ndarray,
    surfaces: np.ndarray,
    disparity: np.ndarray,
    *,
    view: int,
    unseen_by: tuple[int, ...] = (),
) -> Crossings:
    """The crossings of all EPIs of one arm; see the top of this file.

    Args:
        arm: sRGB views [u y x c].
        surfaces: which surface each pixel shows [u y x].
        disparity: px per view step [u y x].
        view: where the far edges are seen.
        unseen_by: views that must not show them (they were counted there).

    Returns:
        Positions in `view`.
    """
    count, height, width = surfaces.shape
    steps = view - np.arange(count)
    lab = np.asarray(srgb_to_lab(jnp.asarray(arm[view])))
    contrast = np.zeros((height, width))
    contrast[:, 1:-1] = np.linalg.norm(lab[:, 2:] - lab[:, :-2], axis=-1)
    own = surfaces[view]
    edge = np.zeros((height, width), bool)
    middle = contrast[:, 2:-2]
    edge[:, 2:-2] = (middle > contrast[:, 1:-3]) & (middle >= contrast[:, 3:-1]) & (middle >= 2.0)
    for shift in (-2, -1, 1, 2):
        edge &= np.roll(own, shift, 1) == own
    y, x = np.nonzero(edge)
    before, top, after = contrast[y, x - 1], contrast[y, x], contrast[y, x + 1]
    bend = np.minimum(before - 2 * top + after, -1e-9)
    position = x + np.clip(0.5 * (before - after) / bend, -0.5, 0.5)
    d, surface = disparity[view, y, x], own[y, x]
    at = np.rint(position[:, None] + steps * d[:, None]).astype(int)
    inside = ((at >= 1) & (at < width - 1)).all(1)
    at = np.clip(at, 1, width - 2)
    every = np.arange(count)[None]
    around = [surfaces[every, y[:, None], at + k] == surface[:, None] for k in (-1, 0, 1)]
    seen = np.logical_and.reduce(around)
    nearest = disparity[every, y[:, None], at]
    hidden = nearest > d[:, None] + 0.1
    keep = inside & hidden.any(1) & (seen.sum(1) >= 3)
    for other in unseen_by:
        keep &= ~seen[:, other]
    near = np.full((len(x), 2), np.nan)
    for j in np.flatnonzero(keep):
        # The hidden view next to one that is not: there the line has just met the border.
        pairs = [(u, u + s) for s in (1, -1) for u in range(count) if 0 <= u + s < count]
        met = [(p, q) for p, q in pairs if hidden[j, q] and not hidden[j, p]]
        if not met:
            keep[j] = False
            continue
        shown, covered = met[0]
        cover = nearest[j, covered]
        line = surfaces[covered, y[j]]
        side = int(np.sign((steps[shown] - steps[covered]) * (d[j] - cover)))
        column = at[j, covered]
        while 0 <= column + side < width and line[column + side] == line[at[j, covered]]:
            column += side
        near[j] = column + 0.5 * side - steps[covered] * cover, cover
    far = np.stack([position, d], -1)
    return Crossings(y[keep], far[keep], near[keep], seen.sum(1)[keep])


def survive(points: EdgePoints, found: Crossings) -> tuple[np.ndarray, np.ndarray]:
    """Which far and which near lines have a point; see the top of this file."""
    valid = np.asarray(points.valid)
    xy, d = np.asarray(points.xy)[valid], np.asarray(points.disparity)[valid]

    def has(line: np.ndarray, row: int) -> bool:
        near = (np.abs(xy[:, 1] - row) <= 0.6) & (np.abs(xy[:, 0] - line[0]) <= 1.5)
        return bool((near & (np.abs(d - line[1]) <= 0.07)).any())

    pairs = list(zip(found.row, found.far, found.near, strict=True))
    far = np.array([has(line, row) for row, line, _ in pairs], bool)
    near = np.array([has(line, row) for row, _, line in pairs], bool)
    return far, near


def crossing_table(
    light_field: LightField, find: Callable[[LightField], EdgePoints]
) -> list[dict[str, Any]]:
    """How many crossings of a light field with full truth survive.

    Args:
        light_field: with the truth of every view; the horizontal EPIs of its center row are used.
        find: the method: a light field without truth in, points of its center view out.

    Returns:
        One row for far edges that the center view shows, one for those that it does not.
    """
    truth = light_field.truth
    assert truth is not None
    assert truth.view_disparity is not None
    assert truth.view_ids is not None
    row, center = light_field.center
    arm = np.asarray(light_field.horizontal_arm)
    surfaces, disparity = np.asarray(truth.view_ids[row]), np.asarray(truth.view_disparity[row])
    blind = light_field.without_truth()
    half = center // 2
    groups: dict[str, list[tuple[int, slice, tuple[int, ...]]]]
    groups = {"shown by the center view": [(center, slice(None), ())]}
    groups["hidden from the center view"] = [
        (view, slice(view - half, view + half + 1), (center,)) for view in (half, center + half)
    ]
    rows = []
    for name, tasks in groups.items():
        far, near, views = [], [], []
        for view, columns, unseen_by in tasks:
            part = eqx.tree_at(
                lambda field: (field.views, field.available),
                blind,
                (blind.views[:, columns], blind.available[:, columns]),
            )
            found = crossings(arm, surfaces, disparity, view=view, unseen_by=unseen_by)
            survived = survive(find(part), found)
            far.append(survived[0])
            near.append(survived[1])
            views.append(found.views)
        far, near, views = (np.concatenate(part) for part in (far, near, views))
        rows.append(
            {
                "far edges": name,
                "crossings": len(far),
                "views, median": float(np.median(views)) if len(views) else float("nan"),
                "far line %": 100 * float(far.mean()) if len(far) else float("nan"),
                "near line %": 100 * float(near.mean()) if len(far) else float("nan"),
                "both %": 100 * float((far & near).mean()) if len(far) else float("nan"),
            }
        )
    return rows
