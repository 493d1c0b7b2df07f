"""What a result says against itself, in sentences for people."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ._edge_to_depth import DepthResult

# Share of the pixels at or beyond the ends of the range, from which the range is doubted.
_AT_THE_ENDS = 0.02
# How near an end is at it, px per view step.
_NEAR = 0.005


def problems(result: "DepthResult") -> tuple[str, ...]:
    """See `DepthResult.problems`."""
    stats, disparity = result.stats, np.asarray(result.disparity)
    if stats.sound is not None and not bool(stats.sound):
        return ("a parameter is NaN, infinite or negative, so the map is NaN.",)
    unknown = int((~np.isfinite(disparity)).sum())
    if unknown:
        return (f"{unknown} of {disparity.size} disparities are NaN or infinite.",)
    found = []
    if not np.isfinite(np.asarray(result.error)).any():
        found.append("no pixel was measured at all: the views show nothing to compare.")
    elif not int(stats.edges.valid):
        # Constant views agree at every disparity, which measurements take for agreement.
        found.append("no edge was found: the views do not determine the map, whatever its error.")
    if not bool(stats.converged):
        found.append("a diffusion stopped before its tolerance.")
    if int(stats.edges.overflow):
        found.append(f"{int(stats.edges.overflow)} weak edges found no slot and were left out.")
    if stats.searched is not None:
        found += _range_doubts(disparity, np.asarray(stats.searched))
    return tuple(found)


def _range_doubts(disparity: np.ndarray, searched: np.ndarray) -> list[str]:
    """Where the range was too narrow, pixels gather beyond its ends."""
    doubts = []
    for end, word, beyond in (
        (searched[0], "lowest", disparity < searched[0] - _NEAR),
        (searched[1], "highest", disparity > searched[1] + _NEAR),
    ):
        if beyond.mean() > _AT_THE_ENDS:
            doubts.append(
                f"{100 * beyond.mean():.0f} % of the pixels lie beyond the {word} disparity that "
                f"was tried, {end:.4g} px: the range is likely to be wider."
            )
    return doubts
