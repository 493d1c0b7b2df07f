"""Epipolar-plane images: oriented filters and lines (Thesis 4.1.1, 4.1.2)."""

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
