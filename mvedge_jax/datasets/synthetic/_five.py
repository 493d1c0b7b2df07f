"""Five photographs from around a scene: what the thesis' multi-view stereo starts from."""

import numpy as np
from jaxtyping import PRNGKeyArray

from mvedge_jax.posed import Photographs

from ._render import render_posed
from .world import Scene

# Places of the cameras in units of the baseline, and no two of them in a row or a column.
_PLACES = (
    (0.0, 0.0, 0.0),
    (0.83, -0.42, 0.12),
    (-0.71, -0.64, -0.1),
    (-0.52, 0.78, 0.08),
    (0.61, 0.7, -0.14),
)
# Turns about the line of sight, degrees.
_ROLLS = (0.0, 3.0, -4.0, 2.0, -2.0)


def five_views(
    scene: Scene,
    *,
    size: tuple[int, int],
    baseline: float = 0.25,
    samples: int = 3,
    key: PRNGKeyArray,
) -> Photographs:
    """Renders five unstructured photographs of a scene, with true poses and depth.

    The first one is the light field's centre camera; the others stand around it, each at its own
    distance from the scene and turned, and look at the same place.

    Args:
        scene: what to photograph.
        size: height and width, px.
        baseline: from the first camera to the others, about, metres.
        samples: see `render`.
        key: draws the sensor's noise.

    Returns:
        The photographs, metres. Not differentiable.

    Raises:
        ValueError: a size is wrong.

    Source: Thesis 7.2.2, "Datasets": five unstructured views, 25 cm apart.

    Example:
        >>> import jax
        >>> from mvedge_jax.datasets import synthetic
        >>> five = synthetic.five_views(
        ...     synthetic.scene("edges"), size=(16, 24), samples=1, key=jax.random.key(0)
        ... )
        >>> five.images.shape
        (5, 16, 24, 3)
    """
    target = np.asarray([0.0, 0.0, float(scene.rig.focus)])
    poses = np.stack(
        [
            _looking(baseline * np.asarray(place), target, roll)
            for place, roll in zip(_PLACES, _ROLLS, strict=True)
        ]
    )
    height, width = size
    focal = float(scene.rig.focal) * max(height, width)
    matrix = np.asarray([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    found = render_posed(scene, poses, matrix, size=size, samples=samples, key=key)
    depth = np.asarray(found.depth)
    return Photographs(
        np.clip(np.asarray(found.images), 0, 1),
        found.poses,
        found.intrinsics,
        depth=np.where(np.isfinite(depth), depth, 0),
        name=f"{scene.name}, five views",
    )


def _looking(place: np.ndarray, target: np.ndarray, roll: float) -> np.ndarray:
    """A pose at a place that looks at a target, camera to world."""
    ahead = (target - place) / np.linalg.norm(target - place)
    right = np.cross([0.0, 1.0, 0.0], ahead)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    c, s = np.cos(np.deg2rad(roll)), np.sin(np.deg2rad(roll))
    pose = np.eye(4)
    pose[:3, :3] = turn @ np.asarray([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    pose[:3, 3] = place
    return pose
