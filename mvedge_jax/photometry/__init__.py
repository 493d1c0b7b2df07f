"""What the colours of the views say: the scene made ready, and the sight of every pixel's views.

Rooms: `brightness` (exposure, noise), `matching` (costs of hypotheses), `measuring` (disparity and
standard error of a pixel).
"""

from ._scene import (
    Scene as Scene,
    Sight as Sight,
    first_labels as first_labels,
    hypothesis_count as hypothesis_count,
    occluder_radius as occluder_radius,
    prepare as prepare,
    recentred as recentred,
    sight as sight,
)
from .brightness import Exposure as Exposure, Noise as Noise
from .matching import VolumeParams as VolumeParams
from .measuring import PhotometricParams as PhotometricParams
