"""What the optimisation minimises (Thesis 7.1.4)."""

from ._features import (
    Colours as Colours,
    FilterBank as FilterBank,
    Vgg16 as Vgg16,
    load_vgg16 as load_vgg16,
)
from ._losses import (
    LossTerms as LossTerms,
    LossWeights as LossWeights,
    SupervisedWeights as SupervisedWeights,
    occlusion_masks as occlusion_masks,
    self_supervised_loss as self_supervised_loss,
    supervised_loss as supervised_loss,
)
from ._terms import (
    Features as Features,
    edge_aware_smoothness as edge_aware_smoothness,
    gradient_reward as gradient_reward,
    reprojection_error as reprojection_error,
    ssim as ssim,
    warp_views as warp_views,
)
from ._views import (
    Views as Views,
    all_views as all_views,
    gather_views as gather_views,
)
