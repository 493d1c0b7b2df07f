"""The parts of depth from posed photographs."""

import math
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import lineax as lx
import numpy as np
from jaxtyping import Array, Float

from mvedge_jax._checks import untraced
from mvedge_jax._params import as_number, at_least, number
from mvedge_jax._paths import Replaceable
from mvedge_jax.depth import DenseLabels, Refine
from mvedge_jax.diffusion import AutoSolver
from mvedge_jax.photometry.brightness import Brightness
from mvedge_jax.photometry.matching import Agreement, Matching
from mvedge_jax.photometry.measuring import Measurement
from mvedge_jax.smoothness import ColorAndDepth, Smoothness

from ._labels import PhotographLabels
from ._reference import STEPS, Reference

# Hypotheses per px of movement in the farthest photograph, and the number that is enough unless
# they are more than a pixel apart: a few photographs far apart show no finer details.
_PER_PX, _ENOUGH = 4.0, 128
# The number of hypotheses is a multiple of this, so that similar ranges share a program.
_ROUND = 16
# More hypotheses would take gigabytes.
_MOST = 768


def _matching() -> Matching:
    """Photographs far apart show less of a pixel, other gloss, and surfaces that are steeper."""
    return Matching(jump=as_number(2.0), agreement=Agreement(), reach=7)


def _measurement() -> Measurement:
    """The same-surface tolerance is looser for posed images."""
    return Measurement(same_surface=as_number(0.05))


def _refine() -> Refine:
    """Labels of few photographs have errors of hundredths of a pixel, not thousandths.

    Hypotheses alone are no accepted labels.
    """
    return Refine(precision=as_number(0.02), accepted=as_number(0.05))


def _solver() -> AutoSolver:
    return AutoSolver(tolerance=1e-5, by_residual=True)


class StereoDepth(Replaceable):
    """Depth of one of a few posed photographs: parts of `EdgeDepth`, without edges.

    Attributes:
        hypotheses: disparities tried per pixel.
        window: half the width of the windows in which hypotheses are compared, px.
        brightness: parameters of gains and noise.
        matching: costs of the hypotheses of the first map; `slant` is not read.
        tilt: penalty, in these costs, of the step of disparity between neighboring pixels on a
            surface at 45 degrees to the line of sight, in proportion for others; it replaces
            `matching.slant`, whatever the distance between hypotheses and between photographs is.
        surface: lower bound of `measurement.same_surface` in these steps, because neighbors on a
            steep surface differ by so much.
        coarse: lower bound of `refine.precision` in these steps, because a window on a steep
            surface averages over so much.
        hypothesis: weight of the first map as labels, see `PhotographLabels`; less where a window
            has no more texture than noise, and where rival hypotheses are as likely.
        measurement: measurement of every pixel; occluders at any distance are found, `radius` is
            not read.
        dense: weights of the measured labels.
        smoothness: weights of the edges between neighboring pixels.
        solver: solver of the diffusions.
        refine: schedule of diffusion and sharpening; `outline` is not read, nor is `error.rival`,
            which is the distance between hypotheses.
    """

    hypotheses: int = eqx.field(static=True)
    window: int = eqx.field(static=True, default=2)
    brightness: Brightness = eqx.field(default_factory=Brightness)
    matching: Matching = eqx.field(default_factory=_matching)
    tilt: Float[Array, ""] = number(0.1, "of a cost of at most 2")
    surface: Float[Array, ""] = number(2.0, "steps at 45 degrees")
    coarse: Float[Array, ""] = number(0.5, "steps at 45 degrees")
    hypothesis: Float[Array, ""] = number(0.015, "perfect labels")
    measurement: Measurement = eqx.field(default_factory=_measurement)
    dense: DenseLabels = eqx.field(default_factory=PhotographLabels)
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
                the farthest photograph, which is four view steps away, or, if these are more than
                128, up to a pixel.
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
            moved = STEPS * (high - low)
            wanted = max(min(_PER_PX * moved, _ENOUGH - 1), moved) + 1
            count = _ROUND * max(1, math.ceil(wanted / _ROUND))
            if count > _MOST:
                raise ValueError(
                    f"`reference` has disparities from {low:.4g} to {high:.4g} px, which ask for "
                    f"{count} hypotheses, expected at most {_MOST}; narrow the range of depths, "
                    "shrink the photographs, or leave out those that are farthest away."
                )
        return StereoDepth(hypotheses=count).replace(choices)
