"""Edge points by the thesis' own steps (Thesis 4.1)."""

from ._edges import ThesisEdges as ThesisEdges
from ._joint_filter import joint_filter as joint_filter
from ._lines import ArmLines as ArmLines, LineSearch as LineSearch, arm_lines as arm_lines
