"""The optimization loop: state, steps, and strategies between them (Thesis 7.1.4)."""

from ._grow import Growth as Growth
from ._optimize import (
    FixedPoints as FixedPoints,
    History as History,
    Progress as Progress,
    Strategy as Strategy,
    advance as advance,
    optimize as optimize,
)
from ._routine import (
    Rates as Rates,
    Routine as Routine,
    all_at_once as all_at_once,
    one_at_a_time as one_at_a_time,
)
from ._state import State as State, begin as begin
