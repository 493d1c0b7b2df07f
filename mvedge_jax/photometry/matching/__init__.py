"""The matching cost of hypotheses, pooled and aggregated along paths."""

from ._cost import VolumeParams as VolumeParams, best_match as best_match, hypotheses as hypotheses
