"""The part `calibration`: views with comparable colors, and a first map."""

from typing import NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._cpu import checkpoint_stage
from mvedge_jax._crosshair import crosshair
from mvedge_jax._params import at_least, cast
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.lightfield import LightField

from ._scene import CalibratedViews, PreparedViews, first_labels, prepare, prepare_views
from .brightness import Brightness, Exposure, GridViews, Known, Noise
from .matching import Matching
from .measuring import Measurement, PhotometricLabels


@runtime_checkable
class Calibration(Protocol):
    """Makes the colors of raw views comparable; called inside `jit`.

    It must not read ground truth, and keeps the dtype of the views.
    """

    def __call__(
        self, light_field: LightField, searched: tuple[float, float], *, every: bool = False
    ) -> CalibratedViews:
        """Removes the cameras' differences in exposure and gain from the views.

        Args:
            light_field: the raw views.
            searched: lowest and highest disparity, px per view step.
            every: calibrate all views instead of the crosshair alone.

        Returns:
            The calibrated crosshair, the exposure and gains removed, and the noise.
            Differentiable.
        """
        ...


class Calibrate(eqx.Module):
    """Measures exposure, gains and noise, and the disparity at which the views agree best.

    Attributes:
        matching: costs of the hypotheses of the first map.
        hypotheses: disparities tried per pixel.
        window: half the width of the windows in which hypotheses are compared, px.
        brightness: parameters of exposure, gains and noise.
        known: exposure and noise that were measured before, to be used as they are; None to measure
            them.
    """

    matching: Matching
    hypotheses: int = eqx.field(static=True)
    window: int = eqx.field(static=True, default=2)
    brightness: Brightness = eqx.field(default_factory=Brightness)
    known: Known | None = None

    def __check_init__(self) -> None:
        at_least(self, hypotheses=2, window=0)

    def __call__(
        self, light_field: LightField, searched: tuple[float, float], *, every: bool = False
    ) -> CalibratedViews:
        """See `Calibration`."""
        dtype = light_field.views.dtype
        tried = jnp.linspace(*searched, self.hypotheses, dtype=dtype)
        return prepare(
            GridViews(light_field, every=every),
            tried,
            self.matching,
            window=self.window,
            brightness=self.brightness,
            known=self.known,
        )


class AsIs(eqx.Module):
    """Takes the views as they are, as the thesis does; no first map."""

    def __call__(
        self, light_field: LightField, searched: tuple[float, float], *, every: bool = False
    ) -> CalibratedViews:
        """See `Calibration`."""
        del searched, every
        dtype = light_field.views.dtype
        exposure = Exposure(jnp.ones((), dtype), jnp.ones(light_field.views.shape[:2], dtype))
        guide = jnp.moveaxis(light_field.center_view, -1, 0)
        lab = jnp.moveaxis(srgb_to_lab(light_field.center_view), -1, 0)
        noise = Noise.of(jnp.zeros((), dtype))
        return CalibratedViews(crosshair(light_field), exposure, noise, guide, lab, None)


class Evidence(NamedTuple):
    """Calibrated views and their measurement, before the search for edges.

    Attributes:
        calibrated: views with comparable colors.
        prepared: the same, prepared for the measurement; None without one.
        measured: disparity and standard error of every pixel, measured around the first map; None
            without a measurement.
        shown: weight of each view of the crosshair at each pixel, the vertical arm first; None
            without a measurement.
    """

    calibrated: CalibratedViews
    prepared: PreparedViews | None
    measured: PhotometricLabels | None
    shown: Float[Array, "s y x"] | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the center view."""
        height, width = self.calibrated.guide.shape[1:]
        return height, width


def gather_evidence(
    light_field: LightField,
    calibration: Calibration,
    measurement: Measurement | None,
    searched: tuple[float, float],
) -> Evidence:
    """Calibrates the views and measures every pixel around the first map.

    Args:
        light_field: the crosshair of views is read, or all of them (`Measurement.views`).
        calibration: see `Calibration`.
        measurement: None for no measurement.
        searched: lowest and highest disparity, px per view step.

    Returns:
        See `Evidence`. Differentiable.
    """
    if measurement is None:
        return Evidence(calibration(light_field, searched), None, None)
    every = light_field if measurement.views == "all" else None
    scene = calibration(light_field, searched, every=every is not None)
    prepared = checkpoint_stage(lambda s, m, every: prepare_views(s, m, every=every))
    views = prepared(scene, cast(measurement, scene.lab.dtype), every)
    return Evidence(scene, views, *checkpoint_stage(first_labels)(scene, views))
