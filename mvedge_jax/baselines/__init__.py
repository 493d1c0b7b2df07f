"""What the method has to beat."""

from ._sweep import (
    Sweep as Sweep,
    SweepSizes as SweepSizes,
    plane_sweep as plane_sweep,
)
