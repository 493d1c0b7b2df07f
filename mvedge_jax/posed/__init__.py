"""Depth from a few posed photographs, by the measurement of light fields.

Subpackages: `sparse` (the thesis' own method: points, diffused and optimized), `objective` (its
loss), `cloud` (surfaces as points), `scores` (errors in depth).
"""

from mvedge_jax._export import register

from ._model import StereoDepth as StereoDepth
from ._photographs import Photographs as Photographs, projections as projections
from ._reference import Reference as Reference, reference_of as reference_of
from ._stereo import (
    PosedSweep as PosedSweep,
    StereoResult as StereoResult,
    StereoStats as StereoStats,
    posed_sweep as posed_sweep,
    stereo as stereo,
)

register(__name__)
