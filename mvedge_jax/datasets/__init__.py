"""Light fields from files and from formulas."""

from ._load import load_light_field as load_light_field
from ._pfm import read_pfm as read_pfm, write_pfm as write_pfm
from ._stanford import CameraSpacing as CameraSpacing, camera_spacing as camera_spacing
