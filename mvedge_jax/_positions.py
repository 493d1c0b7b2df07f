"""Positions of the views of a light field: what is right about them, how far they reach."""

import math
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from ._checks import untraced

# Views of the center row and column may lie so far beside it, view steps: the crosshair is read as
# if they were on it.
_BESIDE = 0.25
# Medians of the distances of neighboring columns and rows, view steps, that can be view steps.
_SPACINGS = (0.1, 10.0)
# No rig is wider, view steps: sizes are chosen from the outermost view.
_WIDEST = 1000.0


def check_positions(positions: Float[np.ndarray, "v u 2"]) -> None:
    """Refuses positions that are none of rows and columns of views, see `LightField`.

    Raises:
        ValueError: they are not finite, those of the center view are not 0, columns do not increase
            along the rows or rows down the columns, views of the crosshair lie beside it, or the
            numbers are no view steps or too many.
    """
    if not np.isfinite(positions).all():
        v, u, _ = (int(i) for i in np.argwhere(~np.isfinite(positions))[0])
        raise ValueError(
            "`positions` must be finite, also of views that are missing, got "
            f"{positions[v, u]} for view (v, u) = ({v}, {u})."
        )
    vc, uc = positions.shape[0] // 2, positions.shape[1] // 2
    if (positions[vc, uc] != 0).any():
        raise ValueError(
            f"`positions` must be (0, 0) for the center view, (v, u) = ({vc}, {uc}), got "
            f"{positions[vc, uc]}."
        )
    for name, number, axis in (("columns", 0, 1), ("rows", 1, 0)):
        apart = np.diff(positions[..., number], axis=axis)
        if (apart <= 0).any():
            v, u = (int(i) for i in np.argwhere(apart <= 0)[0])
            after = (v, u + 1) if axis else (v + 1, u)
            raise ValueError(
                f"`positions` must have {name} that increase {'to the right' if axis else 'down'}, "
                f"got {positions[v, u, number]:g} for view (v, u) = ({v}, {u}) and "
                f"{positions[(*after, number)]:g} for {after}."
            )
        low, high = _SPACINGS
        if apart.size and not low <= np.median(apart) <= high:
            raise ValueError(
                f"`positions` must be in view steps, to which disparities refer: neighboring "
                f"{name} about 1 apart ({low:g} to {high:g}), got {np.median(apart):.4g}."
            )
    if np.abs(positions).max() > _WIDEST:
        v, u, _ = (int(i) for i in np.argwhere(np.abs(positions) > _WIDEST)[0])
        raise ValueError(
            f"`positions` must be within {_WIDEST:g} view steps of the center view, got "
            f"{positions[v, u]} for view (v, u) = ({v}, {u})."
        )
    beside = {"row": np.abs(positions[vc, :, 1]), "column": np.abs(positions[:, uc, 0])}
    for name, away in beside.items():
        if away.max() > _BESIDE:
            at = int(away.argmax())
            place = (vc, at) if name == "row" else (at, uc)
            raise ValueError(
                f"`positions` must have the views of the center {name} on a straight {name}, at "
                f"most {_BESIDE:g} view steps beside it, got {away.max():.3g} for view (v, u) = "
                f"{place}."
            )


def check_regular(light_field: Any, what: str) -> None:
    """Raises a ValueError for a light field with `positions`, where `what` needs a regular grid."""
    if light_field.positions is not None:
        raise ValueError(
            f"`light_field` comes with `positions` of its views, but {what} needs a regular grid: "
            "integer steps, rows as far apart as columns."
        )


def farthest(positions: Float[Array, "v u 2"]) -> int:
    """View steps from the center view to the outermost one along either axis, rounded up.

    Whole numbers, so that light fields of nearly the same positions share their sizes.

    Raises:
        TypeError: positions are traced.
    """
    untraced("light_field.positions", positions)
    return max(math.ceil(float(np.abs(np.asarray(positions)).max()) - 1e-3), 1)
