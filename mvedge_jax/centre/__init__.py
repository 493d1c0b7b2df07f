"""Dense depth of the centre view from multi-view edges (Thesis 6.1).

Room: `solves` (labels, diffused).
"""

from ._edge_to_depth import (
    DepthResult as DepthResult,
    DepthStats as DepthStats,
    edge_to_depth as edge_to_depth,
)
from ._median import weighted_median as weighted_median
from ._parameters import (
    CentreParams as CentreParams,
    Parameters as Parameters,
    Sizes as Sizes,
)
from ._problems import map_problems as map_problems
from ._sharpen import (
    MedianParams as MedianParams,
    Sharpening as Sharpening,
    sharpen as sharpen,
)
from ._smoothness import (
    SmoothnessParams as SmoothnessParams,
    edge_smoothness as edge_smoothness,
)
