"""Results for other tools: COLMAP models, `transforms.json`, point clouds."""

from ._export import write_colmap as write_colmap, write_nerfstudio as write_nerfstudio
from ._ply import from_origin as from_origin, read_ply as read_ply, write_ply as write_ply
