"""The parts of depth from posed photographs."""

import math
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import lineax as lx
import numpy as np

from mvedge_jax._checks import untraced
from mvedge_jax._params import as_number, at_least
from mvedge_jax._paths import Replaceable
from mvedge_jax.depth import DenseLabels, MeasuredLabels, Refine
from mvedge_jax.diffusion import AutoSolver
from mvedge_jax.photometry.brightness import Brightness
from mvedge_jax.photometry.matching import Matching
from mvedge_jax.photometry.measuring import Measurement
from mvedge_jax.smoothness import ColorAndDepth, Smoothness

from ._reference import STEPS, Reference

# Hypotheses per px of movement in the farthest photograph.
_PER_PX = 4.0
# The number of hypotheses is a multiple of this, so that similar ranges share a program.
_ROUND = 16
# More hypotheses would take gigabytes.
_MOST = 768


def _matching() -> Matching:
    """Few, distant photographs give less evidence per pixel, so paths are stiffer."""
    return Matching(truncation=as_number(16.0), slant=as_number(0.4), jump=as_number(2.0))


def _measurement() -> Measurement:
    """The same-surface tolerance is looser for posed images."""
    return Measurement(same_surface=as_number(0.05))


def _refine() -> Refine:
    """Labels of few photographs have errors of hundredths of a pixel, not thousandths."""
    return Refine(precision=as_number(0.02))


def _solver() -> AutoSolver:
    return AutoSolver(tolerance=1e-5, by_residual=True)


class StereoDepth(Replaceable):
    """Depth of one of a few posed photographs: parts of `EdgeDepth`, without edges.

    Attributes:
        hypotheses: disparities tried per pixel.
        window: half the width of the windows in which hypotheses are compared, px.
        brightness: parameters of gains and noise.
        matching: costs of the hypotheses of the first map.
        measurement: measurement of every pixel; occluders at any distance are found, `radius` is
            not read.
        dense: weights of the measured labels.
        smoothness: weights of the edges between neighboring pixels.
        solver: solver of the diffusions.
        refine: schedule of diffusion and sharpening; `outline` is not read.
    """

    hypotheses: int = eqx.field(static=True)
    window: int = eqx.field(static=True, default=2)
    brightness: Brightness = eqx.field(default_factory=Brightness)
    matching: Matching = eqx.field(default_factory=_matching)
    measurement: Measurement = eqx.field(default_factory=_measurement)
    dense: DenseLabels = eqx.field(default_factory=MeasuredLabels)
    smoothness: Smoothness = eqx.field(default_factory=ColorAndDepth)
    solver: lx.AbstractLinearSolver = eqx.field(default_factory=_solver)
    refine: Refine = eqx.field(default_factory=_refine)

    def __check_init__(self) -> None:
        at_least(self, hypotheses=2, window=0)

    @staticmethod
    def of(reference: Reference, *, choices: Mapping[str, Any] | None = None) -> "StereoDepth":
        """Chooses the number of hypotheses on the host.

        Args:
            reference: hypotheses over its range of disparities are a quarter of a pixel apart in
                the farthest photograph, which is four view steps away.
            choices: numbers and static fields to set, by path.

        Returns:
            The model for `stereo`.

        Raises:
            TypeError: the reference is traced.
            ValueError: a choice is out of range, or the range of depths needs too many hypotheses.
        """
        untraced("reference", reference.disparity_range)
        low, high = np.asarray(reference.disparity_range, np.float64)
        choices = dict(choices or {})
        count = choices.pop("hypotheses", None)
        if count is None:
            wanted = _PER_PX * STEPS * (high - low) + 1
            count = _ROUND * max(1, math.ceil(wanted / _ROUND))
            if count > _MOST:
                raise ValueError(
                    f"`reference` has disparities from {low:.4g} to {high:.4g} px, which ask for "
                    f"{count} hypotheses, expected at most {_MOST}; narrow the range of depths, "
                    "shrink the photographs, or leave out those that are farthest away."
                )
        return StereoDepth(hypotheses=count).replace(choices)
