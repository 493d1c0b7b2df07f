"""What the views say about disparity: matching costs, their paths, the dense measurement."""

from ._cost import (
    VolumeParams as VolumeParams,
    hypotheses as hypotheses,
    residual_variance as residual_variance,
)
from ._measure import (
    Look as Look,
    PhotometricLabels as PhotometricLabels,
    PhotometricParams as PhotometricParams,
    labels as labels,
    look as look,
    mismatch as mismatch,
    photometric_labels as photometric_labels,
)
from ._paths import aggregate as aggregate
from ._reach import occlusion_reach as occlusion_reach
