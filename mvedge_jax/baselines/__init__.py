"""What the method is compared with: the thesis' own chains, points alone, plane sweep.

Rooms: `kmeans` (superpixels by k-means), `lfsp` (the thesis' superpixels).
"""

from mvedge_jax._export import register

from ._joint_filter import joint_filter as joint_filter
from ._reproject import reproject_views as reproject_views
from ._sparse_depth import (
    SparseDepth as SparseDepth,
    SparseParams as SparseParams,
    SparseSizes as SparseSizes,
    sparse_depth as sparse_depth,
)
from ._sweep import (
    SweepSizes as SweepSizes,
    plane_sweep as plane_sweep,
)
from ._thesis_depth import thesis_depth as thesis_depth
from ._thesis_edges import thesis_edges as thesis_edges
from ._thesis_params import ThesisParams as ThesisParams, ThesisSizes as ThesisSizes
from ._thesis_views import thesis_views as thesis_views

register(__name__)
