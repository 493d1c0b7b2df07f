"""Ways to improve a map from the views alone: by evidence, by reprojection (Thesis 7.2.1)."""

from ._approach import Approach as Approach
from ._by_evidence import ByEvidence as ByEvidence
from ._by_reprojection import ByReprojection as ByReprojection
from ._evidence import EvidenceParams as EvidenceParams
from ._polish import PolishParams as PolishParams, polish as polish
from ._relocate import RelocateParams as RelocateParams, relocate_steps as relocate_steps
