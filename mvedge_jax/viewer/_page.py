"""One HTML file with everything in it: views, maps, points, and the programs that show them."""

import importlib.resources
import json
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np

from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import depth_scores

from ._encode import packed, packed_labels, picture, text_of
from ._result import Result

_SCRIPTS = ("data", "shaders", "gl", "field", "space", "controls", "panel", "pointer", "main")
# The colors of `plotting`: disparity, error, difference.
_COLORS = ("viridis", "inferno", "RdBu_r")
# Disparities to focus at where nothing is known of the scene, px per view step.
_GUESS = (-2.0, 2.0)


def page(light_field: LightField, *results: Result, quality: int = 90) -> str:
    """A page that needs no server and no network.

    Args:
        light_field: the views; ground truth and camera are shown if known.
        results: maps of its center view, compared if there are two.
        quality: of the views, WebP, 1 to 100, which is without loss; maps keep 16 bits.

    Returns:
        HTML.

    Raises:
        ValueError: a map has another size than the views, two results have one name, or the quality
            is out of range.

    Example:
        >>> import jax.numpy as jnp
        >>> html = page(LightField(jnp.full((1, 3, 16, 16, 3), 0.5)))
        >>> "http" in html.replace('http-equiv', '')
        False
    """
    if not 1 <= quality <= 100:
        raise ValueError(f"`quality` must be between 1 and 100, got {quality}.")
    names = [result.name for result in results]
    if len({*names, "truth"}) <= len(names):
        raise ValueError(f"`results` must have different names, none of them truth, got {names}.")
    size = light_field.views.shape[2:4]
    for result in results:
        if result.disparity.shape != size:
            raise ValueError(
                f"the map of {result.name} must have the size of the views, {size[1]}x{size[0]} "
                f"px, got {result.disparity.shape[1]}x{result.disparity.shape[0]}."
            )
    folder = importlib.resources.files(__package__ or "") / "page"
    # In a script, `<` could end it.
    data = json.dumps(_content(light_field, results, quality), allow_nan=False)
    data = data.replace("<", "\\u003c")
    scripts = "\n".join(
        f"<script>\n{(folder / f'{name}.js').read_text('utf-8')}</script>" for name in _SCRIPTS
    )
    html = (folder / "page.html").read_text("utf-8")
    html = html.replace("/*STYLE*/", (folder / "page.css").read_text("utf-8"))
    return html.replace("<!--SCRIPTS-->", scripts).replace("/*DATA*/", data)


def _content(light_field: LightField, results: Sequence[Result], quality: int) -> dict[str, Any]:
    views, available = np.asarray(light_field.views), np.asarray(light_field.available)
    truth = _known_truth(light_field)
    maps = [result.disparity for result in results] + ([] if truth is None else [truth])
    low, high, middle = _range(light_field, maps)
    errors = [result.error for result in results if result.error is not None]
    spread = np.concatenate([e[np.isfinite(e) & (e > 0)] for e in errors] or [np.array([])])
    spread = spread if spread.size else np.array([0.1])
    shade = np.log(np.quantile(spread, (0.02, 0.98)))
    camera = light_field.camera
    return {
        "name": light_field.name,
        "shape": list(views.shape[:4]),
        "views": [
            picture(views[v, u], quality) if available[v, u] else None
            for v, u in np.ndindex(*available.shape)
        ],
        "results": [_packed_result(result, light_field) for result in results],
        "truth": None if truth is None else packed(truth),
        "range": [low, high],
        "middle": middle,
        "errors": [float(shade[0]), float(max(shade[1], shade[0] + 0.1))],
        "typical": float(np.median(spread)),
        "camera": camera
        and [float(camera.focal_px), float(camera.baseline), 1 / float(camera.focus_distance)],
        "unit": results[0].unit if results else "m",
        "lut": text_of(_tables().tobytes()),
        "notes": _notes(light_field, results),
    }


def _known_truth(light_field: LightField) -> np.ndarray | None:
    truth = light_field.truth
    if truth is None:
        return None
    return np.where(np.asarray(truth.valid), np.asarray(truth.disparity), np.nan)


def _range(light_field: LightField, maps: Sequence[np.ndarray]) -> tuple[float, float, float]:
    """Lowest, highest and middle disparity: of the maps, or as far as it is known."""
    values = np.concatenate([m[np.isfinite(m)] for m in maps] or [np.array([])])
    if values.size:
        low, high, middle = (float(v) for v in (values.min(), values.max(), np.median(values)))
    else:
        known = light_field.disparity_range
        low, high = _GUESS if known is None else (float(v) for v in known)
        middle = min(max(0.0, low), high)
    return low, max(high, low + 0.01), middle


def _packed_result(result: Result, light_field: LightField) -> dict[str, Any]:
    points = {}
    if result.xy is not None and result.points is not None:
        pairs = {"": result.xy, "normal_": result.normals, "surface_": result.surfaces}
        for prefix, pair in pairs.items():
            if pair is not None:
                points[f"{prefix}x"], points[f"{prefix}y"] = packed(pair[:, 0]), packed(pair[:, 1])
        points["disparity"] = packed(result.points[:, 0])
        points["error"] = packed(result.points[:, 1], log=True)
    return {
        "name": result.name,
        "disparity": packed(result.disparity),
        "error": None if result.error is None else packed(result.error, log=True),
        "labels": None if result.labels is None else packed_labels(result.labels),
        "states": [] if result.states is None else [packed(state) for state in result.states],
        "points": points or None,
        "hidden": None if result.hidden is None else _packed_hidden(result.hidden),
        "scores": _scores(result, light_field),
    }


def _packed_hidden(hidden: np.ndarray) -> dict[str, Any]:
    names = ("x", "y", "disparity", "error", "red", "green", "blue")
    columns = zip(names, hidden.T, strict=True)
    return {name: packed(column, log=name == "error") for name, column in columns}


def _scores(result: Result, light_field: LightField) -> list[tuple[str, float]]:
    truth = light_field.truth
    if truth is None or not np.isfinite(result.disparity).all():
        return []
    dtype = truth.disparity.dtype
    found = depth_scores(jnp.asarray(result.disparity, dtype), truth.disparity, mask=truth.valid)
    names = {"mse": "MSE·100", "bad_07": "BP(0.07) %", "q25": "Q25·100"}
    scores = [(label, float(getattr(found, name))) for name, label in names.items()]
    return [(label, value) for label, value in scores if np.isfinite(value)]


def _tables() -> np.ndarray:
    steps = np.linspace(0, 1, 256)
    tables = np.stack([mpl.colormaps[name](steps)[:, :3] for name in _COLORS])
    return np.round(255 * tables).astype(np.uint8)


def _notes(light_field: LightField, results: Sequence[Result]) -> list[str]:
    rows, columns, height, width = light_field.views.shape[:4]
    there = int(np.asarray(light_field.available).sum())
    single = rows * columns == 1
    notes = [f"{'a view' if single else f'{columns}x{rows} views'} of {width}x{height} px"]
    if there < rows * columns:
        notes.append(f"{rows * columns - there} views are missing; the nearest stands in for them.")
    if not results and light_field.truth is None:
        notes.append("There is no map: the views are blended at the disparity of the focus.")
    elif not results:
        notes.append("The map is the ground truth.")
    if light_field.camera is None:
        notes.append("The camera is not known: the geometry is a relief, without meters.")
    return notes
