"""Dense depth from multi-view edges (Thesis 6 and 7)."""

from ._grow import (
    Grown as Grown,
    grow as grow,
    usefulness as usefulness,
    with_capacity as with_capacity,
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
from ._routine import (
    Rates as Rates,
    Routine as Routine,
    all_at_once as all_at_once,
    one_at_a_time as one_at_a_time,
)
from ._sweep import (
    Sweep as Sweep,
    SweepParams as SweepParams,
    SweepSizes as SweepSizes,
    plane_sweep as plane_sweep,
)
