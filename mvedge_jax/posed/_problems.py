"""Problems of a depth map of photographs, as sentences."""

from typing import Any

import numpy as np

# Both limits lie between maps that are right and maps that are wrong, seen on 29 November 2026:
# - right: every reference of `livingroom5` at half size, four of `livingroom_wide5`, eight scenes
#   of `five_views` at 96x128 px, the walls and the room of the tests. At most 67 % of the pixels
#   have no accepted label; since errors contain rival hypotheses, the median standard error is at
#   most 4.0 % of the depth of the rooms and 7.0 % of that of a wall, just below the limit;
# - wrong: the first of `livingroom_wide5`, of which no other photograph shows a quarter (74 %),
#   walls with unrelated textures, with one strange photograph, with wrong poses: at least 82 %, and
#   at least 12 % of the depth.
_UNLABELED = 0.7
_VAGUE = 0.07


def depth_problems(depth: Any, error: Any, labeled: Any) -> tuple[str, ...]:
    """Problems of a depth map, by the share of labeled pixels and its stated error, on the host.

    One sentence per problem; none if no depth or no error is finite.

    Example:
        >>> depth_problems(np.full((2, 2), 2.0), np.full((2, 2), 0.3), 0.9)
        ('half of the pixels have a standard error above 15 % of their depth.',)
    """
    relative = float(np.median(np.asarray(error) / np.asarray(depth)))
    if not np.isfinite(relative):
        return ()
    found, unlabeled = [], 1 - float(labeled)
    if unlabeled > _UNLABELED:
        found.append(
            f"{100 * unlabeled:.0f} % of the pixels have no accepted label: the photographs "
            "disagree there, or show no texture, and the depth is only diffused from other pixels. "
            "Photographs nearer to each other, or better poses, may help."
        )
    if relative > _VAGUE:
        found.append(
            f"half of the pixels have a standard error above {100 * relative:.0f} % of their depth."
        )
    return tuple(found)
