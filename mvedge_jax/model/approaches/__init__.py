"""Ways to improve a map from the views alone: by evidence, by reprojection (Thesis 7.2.1)."""

from ._approach import Approach as Approach
from ._by_evidence import ByEvidence as ByEvidence
from ._by_reprojection import ByReprojection as ByReprojection
from ._evidence import ViewAgreement as ViewAgreement
from ._polish import Bending as Bending, polish as polish
