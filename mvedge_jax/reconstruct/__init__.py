"""Dense depth from multi-view edges (Thesis 6 and 7)."""

from ._edge_to_depth import (
    DepthResult as DepthResult,
    DepthStats as DepthStats,
    edge_to_depth as edge_to_depth,
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
    Evidence as Evidence,
    EvidenceParams as EvidenceParams,
    agreed_correction as agreed_correction,
    view_evidence as view_evidence,
)
from ._grow import (
    Grown as Grown,
    GrowParams as GrowParams,
    grow as grow,
    optimise_growing as optimise_growing,
    usefulness as usefulness,
    with_capacity as with_capacity,
    without_free_places as without_free_places,
    worst_pixels as worst_pixels,
)
from ._lbfgs import Minimised as Minimised, minimise_lbfgs as minimise_lbfgs
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
    History as History,
    State as State,
    advance as advance,
    begin as begin,
    load_state as load_state,
    optimise as optimise,
    save_state as save_state,
)
from ._parameters import (
    CentreParams as CentreParams,
    Parameters as Parameters,
    Sizes as Sizes,
)
from ._polish import (
    PolishParams as PolishParams,
    bending as bending,
    polish as polish,
)
from ._refine import (
    Refinement as Refinement,
    RefineParams as RefineParams,
    finish_refinement as finish_refinement,
    prepare_refinement as prepare_refinement,
)
from ._relocate import (
    RelocateParams as RelocateParams,
    relocate_steps as relocate_steps,
)
from ._routine import (
    Rates as Rates,
    Routine as Routine,
    all_at_once as all_at_once,
    one_at_a_time as one_at_a_time,
)
from ._sharpen import (
    MedianParams as MedianParams,
    Sharpening as Sharpening,
    sharpen as sharpen,
    weighted_median as weighted_median,
)
from ._smoothness import (
    SmoothnessParams as SmoothnessParams,
    edge_smoothness as edge_smoothness,
)
from ._start import (
    Start as Start,
    StartParams as StartParams,
    fit_to_map as fit_to_map,
    start_from_points as start_from_points,
    trust_labels as trust_labels,
)
from ._sweep import (
    Sweep as Sweep,
    SweepParams as SweepParams,
    SweepSizes as SweepSizes,
    plane_sweep as plane_sweep,
)
