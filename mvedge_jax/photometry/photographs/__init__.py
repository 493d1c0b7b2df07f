"""The same for posed photographs: where they show a pixel, costs of hypotheses, the scene."""

from .._places import Projection as Projection
from ._posed_cost import posed_hypotheses as posed_hypotheses
from ._posed_scene import (
    PosedScene as PosedScene,
    PreparedPhotographs as PreparedPhotographs,
    posed_sight as posed_sight,
    prepare_photographs as prepare_photographs,
)
