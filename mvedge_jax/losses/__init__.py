"""Losses of the optimization (Thesis 7.1.4).

Subpackages: `terms` (terms of the losses), `features` (image features to compare).
"""

from mvedge_jax._export import register

from ._losses import (
    LossTerms as LossTerms,
    LossWeights as LossWeights,
    SupervisedWeights as SupervisedWeights,
    occlusion_masks as occlusion_masks,
    self_supervised_loss as self_supervised_loss,
    supervised_loss as supervised_loss,
)
from ._views import Views as Views, all_views as all_views, gather_views as gather_views

register(__name__)
