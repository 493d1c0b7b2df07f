"""The differentiable model of multi-view edges: rendering, objectives, optimisation (Thesis 7)."""

from ._approach import (
    Approach as Approach,
    Prepared as Prepared,
)
from ._by_evidence import ByEvidence as ByEvidence
from ._by_reprojection import ByReprojection as ByReprojection
from ._capacity import (
    with_capacity as with_capacity,
    without_free_places as without_free_places,
)
from ._encode import (
    Encoding as Encoding,
    decode as decode,
    encode as encode,
    load_encoding as load_encoding,
    save_encoding as save_encoding,
)
from ._evidence import (
    Correction as Correction,
    EvidenceParams as EvidenceParams,
    agreed_correction as agreed_correction,
)
from ._fit_edges import (
    FitParams as FitParams,
    fit_edges as fit_edges,
)
from ._grow import (
    Growth as Growth,
    grow as grow,
    usefulness as usefulness,
    worst_pixels as worst_pixels,
)
from ._lbfgs import (
    Minimised as Minimised,
    minimise_lbfgs as minimise_lbfgs,
)
from ._model import (
    DepthModel as DepthModel,
    ModelParams as ModelParams,
    ModelSizes as ModelSizes,
    Rendered as Rendered,
    downsample as downsample,
    image_roughness as image_roughness,
    map_roughness as map_roughness,
    render_model as render_model,
    upsample as upsample,
)
from ._objectives import (
    SelfSupervised as SelfSupervised,
    Supervised as Supervised,
    Trust as Trust,
    unlimited as unlimited,
)
from ._optimise import (
    FixedPoints as FixedPoints,
    Grown as Grown,
    History as History,
    Objective as Objective,
    Plan as Plan,
    Progress as Progress,
    Strategy as Strategy,
    advance as advance,
    optimise as optimise,
)
from ._optimize_edges import optimize_edges as optimize_edges
from ._polish import (
    PolishParams as PolishParams,
    bending as bending,
    polish as polish,
)
from ._relocate import (
    RelocateParams as RelocateParams,
    relocate_steps as relocate_steps,
)
from ._result import (
    Optimised as Optimised,
    Verdict as Verdict,
)
from ._routine import (
    Rates as Rates,
    Routine as Routine,
    all_at_once as all_at_once,
    one_at_a_time as one_at_a_time,
)
from ._start import (
    Start as Start,
    StartParams as StartParams,
    fit_to_map as fit_to_map,
    start_from_depth as start_from_depth,
    start_from_image as start_from_image,
    start_from_points as start_from_points,
    trust_labels as trust_labels,
)
from ._state import (
    State as State,
    begin as begin,
    load_state as load_state,
    save_state as save_state,
)
