"""Views that do not show the scene: of dead cameras, lens caps, dropped and repeated frames."""

import warnings
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float

from mvedge_jax.lightfield import LightField

from ._source import Source

# Side of the blocks that are averaged before contrast is measured, so that noise shows none, px.
_BLOCK = 8
# Contrast of a blank view relative to the others, and their least contrast for this test.
_FLAT, _CONTRAST = 0.05, 0.5 / 255
# Share of black and white pixels beyond which a view is saturated, and below which the others are
# not.
_CLIPPED, _OPEN = 0.95, 0.5
# Share of black pixels by which a view that is partly black exceeds the others.
_PARTLY = 0.2
# Distance from black and white, half a step of 8 bits, and mean of a picture that is called so.
_STEP, _PLAIN = 0.5 / 255, 0.04
# Mean difference of neighboring views above which two equal views cannot both be right.
_PARALLAX = 0.5 / 255


class _Look(NamedTuple):
    """Contrast and mean of a view, and its shares of black and of white pixels."""

    contrast: float
    mean: float
    black: float
    white: float


def find_dead_views(light_field: LightField) -> dict[tuple[int, int], str]:
    """Finds views that do not show the scene; `load_light_field` leaves them out by itself.

    A view is black, white or of one color if it has hardly any contrast and at least a quarter of
    the views have contrast; noise does not count as contrast. It is saturated if nearly all of it
    is black or white and most others are not, and partly black if its black share exceeds that of
    the others by a fifth. It is a repetition if it equals another view exactly and most neighbors
    differ; of equal views, only the center view is trusted. What all views share is ignored: plain
    walls, dark scenes, vignettes, no parallax. NumPy on the host.

    Args:
        light_field: the views, concrete.

    Returns:
        Descriptions such as `black`, by index `(v, u)`.

    Example:
        >>> import jax.numpy as jnp
        >>> views = np.random.default_rng(0).uniform(size=(3, 3, 32, 32, 3))
        >>> views[1, 2] = 0
        >>> find_dead_views(LightField(jnp.asarray(views, jnp.float32)))
        {(1, 2): 'black'}
    """
    found = _dead_views(np.asarray(light_field.views), np.asarray(light_field.available))
    return {
        place: f"the same picture as view (v, u) = {what}" if isinstance(what, tuple) else what
        for place, what in found.items()
    }


def leave_out_dead_views(
    views: Float[np.ndarray, "v u y x c"],
    available: Bool[np.ndarray, "v u"],
    source: Source,
    rows: list[int],
    columns: list[int],
) -> None:
    """Clears views that do not show the scene, in place, and warns of them by their files.

    `rows` and `columns` are those of the file order. A dead center view is a ValueError.
    """
    count, dead = int(available.sum()), _dead_views(views, available)
    if not dead:
        return

    def label(place: tuple[int, int]) -> str:
        return source.label(rows[place[0]], columns[place[1]])

    def file(place: tuple[int, int]) -> str:
        return Path(label(place)).name

    center = len(rows) // 2, len(columns) // 2
    if center in dead:
        raise ValueError(
            f"{label(center)}, the center view, is {dead[center]}, unlike other views; expected it "
            "to show the scene, as depth is that of the center view."
        )
    found = []
    for place, what in dead.items():
        views[place], available[place] = 0, False
        what = f"the same picture as {file(what)}" if isinstance(what, tuple) else what
        found.append(f"{file(place)} is {what}")
    shown = "; ".join(found[:4]) + (f"; and {len(found) - 4} more" if len(found) > 4 else "")
    warnings.warn(
        f"{source.name}: {len(dead)} of {count} views left out as missing, as they do not show the "
        f"scene: {shown}.",
        stacklevel=3,
    )


def _dead_views(
    views: Float[np.ndarray, "v u y x c"], available: Bool[np.ndarray, "v u"]
) -> dict[tuple[int, int], str | tuple[int, int]]:
    """By index, a description of the view, or the index of the view that it repeats."""
    places = [(int(v), int(u)) for v, u in np.argwhere(available)]
    looks = [_look(views[place]) for place in places]
    contrast = float(np.quantile([look.contrast for look in looks], 0.75))
    black, clipped = (
        float(np.quantile(shares, 0.25))
        for shares in zip(*((look.black, look.black + look.white) for look in looks), strict=True)
    )
    found: dict[tuple[int, int], str | tuple[int, int]] = {}
    for place, look in zip(places, looks, strict=True):
        if contrast > _CONTRAST and look.contrast < _FLAT * contrast:
            named = {look.mean < _PLAIN: "black", look.mean > 1 - _PLAIN: "white"}
            found[place] = named.get(True, "of one color")
        elif look.black + look.white > _CLIPPED and clipped < _OPEN:
            found[place] = "saturated"
        elif look.black > black + _PARTLY:
            found[place] = f"black in {100 * look.black:.0f} % of its pixels"
    alive = [place for place in places if place not in found]
    return found | dict(_repetitions(views, alive))


def _look(view: Float[np.ndarray, "y x c"]) -> _Look:
    height, width = view.shape[:2]
    block = max(1, min(_BLOCK, height // 4, width // 4))
    size = width // block, height // block
    blocks = cv2.resize(view, size, interpolation=cv2.INTER_AREA)
    some = view[:: block // 2 + 1, :: block // 2 + 1]
    black, white = ((side <= _STEP).all(-1).mean() for side in (some, 1 - some))
    # Per channel, because a colored picture may have the same gray value everywhere.
    deviation = blocks.std((0, 1)).max()
    return _Look(float(deviation), float(blocks.mean()), float(black), float(white))


def _repetitions(
    views: np.ndarray, places: list[tuple[int, int]]
) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Views that are wrong because they equal another one, and that one."""
    groups: dict[bytes, list[tuple[int, int]]] = {}
    for place in places:
        groups.setdefault(views[place][::8].tobytes(), []).append(place)
    equal = [
        [place for place in group if np.array_equal(views[place], views[group[0]])]
        for group in groups.values()
    ]
    equal = [group for group in equal if len(group) > 1]
    alike = sum(map(len, equal))
    if not alike or 2 * alike >= len(places) or _parallax(views, places) < _PARALLAX:
        return []
    center = views.shape[0] // 2, views.shape[1] // 2
    return [
        (place, center if center in group else next(other for other in group if other != place))
        for group in equal
        for place in group
        if place != center
    ]


def _parallax(views: np.ndarray, places: list[tuple[int, int]]) -> float:
    """Median over neighboring views of their mean absolute difference; 0 without neighbors."""
    there = set(places)
    pairs = [
        (place, beside)
        for place in places
        for beside in ((place[0] + 1, place[1]), (place[0], place[1] + 1))
        if beside in there
    ]
    found = [float(np.abs(views[one][::8] - views[other][::8]).mean()) for one, other in pairs]
    return float(np.median(found)) if found else 0.0
