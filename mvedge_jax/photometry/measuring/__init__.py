"""The measurement: disparity and standard error of every pixel around a map."""

from ._crosshair import CrosshairSplines as CrosshairSplines, NormalEquations as NormalEquations
from ._grid import ViewSplines as ViewSplines
from ._measure import (
    PhotometricLabels as PhotometricLabels,
    labels as labels,
    residual_variance as residual_variance,
)
from ._measuring import (
    AdaptedMeasurement as AdaptedMeasurement,
    Measurement as Measurement,
)
from ._visible_range import visible_view_range as visible_view_range
