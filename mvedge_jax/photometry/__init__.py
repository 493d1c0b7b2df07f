"""What the colors of the views say: calibrated views, and the measurement of every pixel in them.

Views are the crosshair of a light field, or a `ViewSet` in any places, such as posed photographs.
Rooms: `views` (where they show a pixel), `brightness` (exposure, noise), `matching` (costs of
hypotheses), `measuring` (disparity and standard error of a pixel).
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
    recentred as recentred,
)
from .brightness import Noise as Noise
