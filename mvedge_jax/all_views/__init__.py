"""Depth of every view (Thesis 6.1)."""

from ._model import ViewDepth as ViewDepth
from ._views import ViewDepths as ViewDepths, depth_of_views as depth_of_views
