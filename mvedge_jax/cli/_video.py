"""How much the maps of a video change from frame to frame."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from mvedge_jax.datasets import read_pfm
from mvedge_jax.depth import DepthResult
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import TemporalConsistency, temporal_consistency

from ._output import MARKER
from ._source import read_scene

# Columns of the summary.
COLUMNS = TemporalConsistency._fields


class Video:
    """Compares each frame with the one before it, whose view it remembers."""

    def __init__(self) -> None:
        self._last: tuple[Path, Any] | None = None

    def change(
        self,
        light_field: LightField,
        result: DepthResult,
        scene: Path,
        before: tuple[Path, Path] | None,
        **reading: Any,
    ) -> dict[str, float]:
        """`temporal_consistency` of a frame and the one before; empty without a map of its size.

        Args:
            light_field: the frame.
            result: its map.
            scene: its path.
            before: light field and result of the frame before it, as paths; None for the first.
            **reading: options with which light fields are read.
        """
        last, self._last = self._last, (scene, light_field.center_view)
        if before is None or not (before[1] / MARKER).exists():
            return {}
        if last is None or last[0] != before[0]:  # made by an earlier run
            last = before[0], read_scene(before[0], **reading)[0].center_view
        disparity = np.asarray(read_pfm(before[1] / "disparity.pfm"))
        if disparity.shape != result.disparity.shape or last[1].shape != self._last[1].shape:
            return {}
        noise = result.stats.noise.deviation / result.stats.exposure.scale
        found = temporal_consistency(
            result.disparity, jnp.asarray(disparity), self._last[1], last[1], noise=noise
        )
        return {name: round(float(value), 5) for name, value in found._asdict().items()}
