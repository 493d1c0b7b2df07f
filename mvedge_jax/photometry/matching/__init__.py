"""The matching cost of hypotheses, pooled and aggregated along paths."""

from ._agreement import Agreement as Agreement
from ._cost import (
    Hypotheses as Hypotheses,
    Matching as Matching,
    best_match as best_match,
    hypotheses as hypotheses,
)
from ._plane_sweep import PlaneSweep as PlaneSweep, plane_sweep as plane_sweep
from ._pooling import Pooling as Pooling
from ._unexplained import between_views_variance as between_views_variance
