"""Multi-view edges and dense, occlusion-correct depth from light fields, in JAX."""

from .lightfield import Camera as Camera, GroundTruth as GroundTruth, LightField as LightField
