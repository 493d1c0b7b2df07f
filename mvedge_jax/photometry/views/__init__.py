"""Views at any positions (photographs or light fields), and where they show a pixel."""

from ._parallax import (
    GridShift as GridShift,
    Parallax as Parallax,
    PlaneParallax as PlaneParallax,
)
from ._views import ViewSet as ViewSet, views_of as views_of
