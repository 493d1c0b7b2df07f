"""Photometric measurement: calibrated views, and disparity and standard error of every pixel.

Views are the crosshair of a light field, or a `ViewSet` at any positions, such as posed
photographs. Subpackages: `views` (positions of a pixel in the views), `brightness` (exposure,
noise), `matching` (costs of hypotheses), `measuring` (disparity and standard error of a pixel).
"""

from ._calibration import (
    AsIs as AsIs,
    Calibrate as Calibrate,
    Calibration as Calibration,
    Evidence as Evidence,
    gather_evidence as gather_evidence,
)
from ._scene import (
    CalibratedViews as CalibratedViews,
    PreparedViews as PreparedViews,
    first_labels as first_labels,
    hypothesis_count as hypothesis_count,
    occluder_radius as occluder_radius,
    prepare as prepare,
    prepare_views as prepare_views,
    recenterd as recenterd,
)
from .brightness import Noise as Noise
