"""What the method has to beat."""

from ._reproject import reproject_views as reproject_views
from ._sweep import (
    Sweep as Sweep,
    SweepSizes as SweepSizes,
    plane_sweep as plane_sweep,
)
