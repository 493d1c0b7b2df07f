"""The measurement: disparity and standard error of a pixel around a map, in the views it shows."""

from ._grid import Grid as Grid, grid_of as grid_of, look_around as look_around
from ._look import (
    Look as Look,
    arm_splines as arm_splines,
    look as look,
    look_with_weights as look_with_weights,
)
from ._measure import (
    PhotometricLabels as PhotometricLabels,
    labels as labels,
    mismatch as mismatch,
    photometric_labels as photometric_labels,
)
from ._measuring import (
    Measurement as Measurement,
    Measuring as Measuring,
)
from ._reach import occlusion_reach as occlusion_reach
