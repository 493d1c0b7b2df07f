"""Epipolar-plane images: oriented filters, lines, segments (Thesis 4.1.1, 4.1.2, 4.2.1)."""

from ._bank import (
    FilterBank as FilterBank,
    bank_radius as bank_radius,
    exponential_disparities as exponential_disparities,
    prewitt_bank as prewitt_bank,
)
from ._lines import (
    EpiLines as EpiLines,
    epi_edge_map as epi_edge_map,
    fit_lines as fit_lines,
    merge_scales as merge_scales,
)
from ._response import strongest_response as strongest_response
from ._segments import (
    EpiSegments as EpiSegments,
    match_segments as match_segments,
    opening_sides as opening_sides,
)
