"""Multi-view edges from epipolar-plane images (Thesis 4.1)."""

from ._alignment import (
    aligned_count as aligned_count,
    alignment as alignment,
    line_visibility as line_visibility,
    longest_run as longest_run,
)
from ._bank import (
    FilterBank as FilterBank,
    bank_radius as bank_radius,
    exponential_disparities as exponential_disparities,
    line_taps as line_taps,
    prewitt_bank as prewitt_bank,
)
from ._edges import (
    measured_edges as measured_edges,
    multiview_edges as multiview_edges,
    scene_banks as scene_banks,
    thesis_edges as thesis_edges,
)
from ._entropy import entropy_search as entropy_search, line_entropy as line_entropy
from ._joint_filter import joint_filter as joint_filter
from ._lines import (
    EpiLines as EpiLines,
    epi_edge_map as epi_edge_map,
    fit_lines as fit_lines,
    merge_scales as merge_scales,
)
from ._params import EdgeParams as EdgeParams, EdgeSizes as EdgeSizes
from ._points import EdgePoints as EdgePoints, Edges as Edges, EdgeStats as EdgeStats
from ._range import disparity_range as disparity_range, scene_range as scene_range
from ._response import (
    bank_response as bank_response,
    sheared_response as sheared_response,
    strongest_response as strongest_response,
)
from ._thesis import ThesisParams as ThesisParams, ThesisSteps as ThesisSteps
from ._vote import spatial_vote as spatial_vote
