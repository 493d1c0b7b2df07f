"""Depth from a few posed photographs (Thesis 7.2.2), by the light field's own measurement."""

from ._cloud import (
    Surface as Surface,
    photographs_of as photographs_of,
    surface_of as surface_of,
)
from ._parameters import (
    Reference as Reference,
    StereoParams as StereoParams,
    StereoSizes as StereoSizes,
    reference_of as reference_of,
)
from ._photographs import Photographs as Photographs, projections as projections
from ._scores import (
    DepthErrors as DepthErrors,
    depth_errors as depth_errors,
    scale_to as scale_to,
)
from ._stereo import (
    PosedSweep as PosedSweep,
    StereoResult as StereoResult,
    StereoStats as StereoStats,
    posed_sweep as posed_sweep,
    stereo as stereo,
)
