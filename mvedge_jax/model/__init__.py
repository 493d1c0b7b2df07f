"""The differentiable model of multi-view edges: rendering, objectives, optimisation (Thesis 7)."""

from ._approach import Approach as Approach
from ._by_evidence import ByEvidence as ByEvidence
from ._by_reprojection import ByReprojection as ByReprojection
from ._encode import (
    Encoding as Encoding,
    decode as decode,
    encode as encode,
)
from ._evidence import EvidenceParams as EvidenceParams
from ._fit_edges import FitParams as FitParams, fit_edges as fit_edges
from ._grow import Growth as Growth
from ._model import (
    DepthModel as DepthModel,
    ModelParams as ModelParams,
    ModelSizes as ModelSizes,
    render_model as render_model,
)
from ._objectives import SelfSupervised as SelfSupervised, Supervised as Supervised, Trust as Trust
from ._optimise import (
    FixedPoints as FixedPoints,
    History as History,
    Progress as Progress,
    Strategy as Strategy,
    advance as advance,
    optimise as optimise,
)
from ._optimize_edges import optimize_edges as optimize_edges
from ._polish import PolishParams as PolishParams, polish as polish
from ._relocate import RelocateParams as RelocateParams, relocate_steps as relocate_steps
from ._result import Optimised as Optimised
from ._routine import (
    Rates as Rates,
    Routine as Routine,
    all_at_once as all_at_once,
    one_at_a_time as one_at_a_time,
)
from ._start import (
    Start as Start,
    StartParams as StartParams,
    start_from_depth as start_from_depth,
    start_from_image as start_from_image,
)
from ._state import (
    State as State,
    begin as begin,
)
