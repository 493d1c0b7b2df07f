"""Posed photographs from COLMAP models, `transforms.json`, trajectories and cameras by hand."""

from ._photographs import load_photographs as load_photographs, open_photographs as open_photographs
