"""Epipolar-plane images: oriented filters, lines, the thesis' way to points (Thesis 4.1)."""

from ._bank import (
    FilterBank as FilterBank,
    bank_radius as bank_radius,
    exponential_disparities as exponential_disparities,
    prewitt_bank as prewitt_bank,
)
from ._lines import EpiLines as EpiLines, epi_edge_map as epi_edge_map, fit_lines as fit_lines
from ._response import (
    sheared_response as sheared_response,
    strongest_response as strongest_response,
)
from ._thesis import (
    ThesisParams as ThesisParams,
    ThesisSteps as ThesisSteps,
    thesis_points as thesis_points,
)
