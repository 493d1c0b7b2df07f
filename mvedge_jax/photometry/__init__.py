"""What the views say about disparity: matching costs, their paths, the dense measurement."""

from ._cost import (
    VolumeParams as VolumeParams,
    hypotheses as hypotheses,
    residual_variance as residual_variance,
)
from ._measure import (
    PhotometricLabels as PhotometricLabels,
    PhotometricParams as PhotometricParams,
    photometric_labels as photometric_labels,
)
from ._paths import aggregate as aggregate
from ._reach import occlusion_reach as occlusion_reach
