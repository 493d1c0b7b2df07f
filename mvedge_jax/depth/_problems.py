"""Problems of a result, as sentences."""

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from ._result import DepthResult


def problems(result: "DepthResult") -> tuple[str, ...]:
    """See `DepthResult.problems`."""
    stats = result.stats
    if not bool(stats.sound):
        return ("a parameter is NaN, infinite or negative, so the map is NaN.",)
    found = list(map_problems(result.disparity, result.error, stats.converged, stats.searched))
    if not np.isfinite(np.asarray(result.disparity)).all():
        found.append(
            "a black view may be why: `datasets.find_dead_views` names it, and "
            "`LightField.without_views` leaves it out."
        )
    found += _vignette_doubts(stats.exposure)
    if not int(stats.edges.valid):
        # A step between two plain surfaces may be the end of one, which fits any disparity.
        found.append("no edge was found: the views do not determine the map, whatever its error.")
    if int(stats.edges.overflow):
        found.append(f"{int(stats.edges.overflow)} weak edges found no slot and were left out.")
    return tuple(found)


def _vignette_doubts(exposure: Any, *, most: float = 0.3) -> list[str]:
    """Warns of strong vignettes: their differences are removed, the center view's own is not."""
    uneven = np.asarray(exposure.unevenness)
    if not (uneven > most).any():
        return []
    v, u = np.unravel_index(np.argmax(uneven), uneven.shape)
    return [
        f"the vignettes of the views differ: the brightness of view ({v}, {u}) varies by "
        f"{100 * uneven[v, u]:.0f} % (standard deviation) over the frame against the center "
        "view's; calibrate the views with pictures of a white wall."
    ]


def map_problems(
    disparity: Any,
    error: Any,
    converged: Any,
    searched: Any,
    *,
    vague: float = 0.25,
    beyond: float = 0.02,
    near: float = 0.005,
) -> tuple[str, ...]:
    """Problems of a disparity map, by its statistics, on the host.

    Args:
        disparity: px, `[y, x]`.
        error: its standard error, px, `[y, x]`.
        converged: whether every diffusion reached its tolerance.
        searched: lowest and highest disparity that was tried, px.
        vague: a map is doubted if its median error exceeds this share of the range.
        beyond: the range is doubted if this share of the pixels lies beyond one end.
        near: pixels up to this far beyond an end, px, count as within the range.

    Returns:
        One sentence per problem.

    Example:
        >>> map_problems(np.zeros((2, 2)), np.full((2, 2), 0.01), False, (-1.0, 1.0))
        ('a diffusion stopped before its tolerance.',)
    """
    disparity, error, searched = np.asarray(disparity), np.asarray(error), np.asarray(searched)
    unknown = int((~np.isfinite(disparity)).sum())
    if unknown:
        return (f"{unknown} of {disparity.size} disparities are NaN or infinite.",)
    found, span = [], float(searched[1] - searched[0])
    if not np.isfinite(error).any():
        found.append("no pixel was measured at all: the views show nothing to compare.")
    elif np.median(error) > vague * span:
        found.append(
            f"half of the pixels have a standard error above {np.median(error):.3g} px, of a range "
            f"of {span:.3g} px: the views tell little about them."
        )
    if not bool(converged):
        found.append("a diffusion stopped before its tolerance.")
    return (*found, *_range_doubts(disparity, searched, beyond, near))


def _range_doubts(
    disparity: np.ndarray, searched: np.ndarray, most: float, near: float
) -> list[str]:
    """Warns of a range that is too narrow: pixels gather beyond its ends."""
    doubts = []
    for end, word, outside in (
        (searched[0], "lowest", disparity < searched[0] - near),
        (searched[1], "highest", disparity > searched[1] + near),
    ):
        if outside.mean() > most:
            doubts.append(
                f"{100 * outside.mean():.0f} % of the pixels lie beyond the {word} disparity that "
                f"was tried, {end:.4g} px: the range is likely to be wider."
            )
    return doubts
