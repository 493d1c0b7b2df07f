"""Depth of every view (Thesis 6.1)."""

from ._parameters import ViewParams as ViewParams, ViewSizes as ViewSizes
from ._views import ViewDepths as ViewDepths, depth_of_views as depth_of_views
