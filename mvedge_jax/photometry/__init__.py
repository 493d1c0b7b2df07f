"""What the colours of the views say: brightness, noise, matching costs, the dense measurement."""

from ._cost import VolumeParams as VolumeParams, best_match as best_match, hypotheses as hypotheses
from ._denoise import denoised as denoised
from ._exposure import Exposure as Exposure, expose as expose, rough_exposure as rough_exposure
from ._grid import (
    Grid as Grid,
    PosedGrid as PosedGrid,
    grid_of as grid_of,
    look_around as look_around,
)
from ._look import Look as Look, look as look, view_weights as view_weights
from ._measure import (
    PhotometricLabels as PhotometricLabels,
    labels as labels,
    mismatch as mismatch,
    photometric_labels as photometric_labels,
)
from ._measuring import Measuring as Measuring, PhotometricParams as PhotometricParams
from ._noise import Noise as Noise, measure_noise as measure_noise
from ._places import Projection as Projection
from ._posed_cost import posed_hypotheses as posed_hypotheses
from ._posed_scene import (
    PosedScene as PosedScene,
    PosedSight as PosedSight,
    posed_sight as posed_sight,
    prepare_photographs as prepare_photographs,
)
from ._reach import occlusion_reach as occlusion_reach
from ._scene import (
    Scene as Scene,
    Sight as Sight,
    first_labels as first_labels,
    hypothesis_count as hypothesis_count,
    occluder_radius as occluder_radius,
    prepare as prepare,
    sight as sight,
)
