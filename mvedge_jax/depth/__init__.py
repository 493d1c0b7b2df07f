"""Dense depth of the center view from multi-view edges: a chain of parts (Thesis 4 and 6.1).

Subpackages: `solves` (from labels to the map), `steps` (of images that are read in parts).
"""

from ._dense import DenseLabels as DenseLabels, MeasuredLabels as MeasuredLabels
from ._edge_depth import (
    EdgeDepth as EdgeDepth,
    depth as depth,
    estimate_depth as estimate_depth,
    multiview_edges as multiview_edges,
)
from ._labels import (
    NearestLabels as NearestLabels,
    PointLabels as PointLabels,
    PointWeight as PointWeight,
    SharedLabels as SharedLabels,
    SplattedLabels as SplattedLabels,
    StepWeight as StepWeight,
)
from ._problems import map_problems as map_problems
from ._refine import Refine as Refine
from ._result import DepthResult as DepthResult, DepthStats as DepthStats
from ._sharpen import Sharpen as Sharpen
