"""Brightness and noise of the views, measured once and compensated before comparing them."""

from ._brightness import Brightness as Brightness, NoiseModel as NoiseModel
from ._denoise import denoised as denoised, low_pass as low_pass
from ._exposure import Exposure as Exposure, expose as expose
from ._noise import (
    Known as Known,
    Noise as Noise,
    measure_noise as measure_noise,
    rough_brightness as rough_brightness,
)
from ._uncalibrated import GridViews as GridViews, PosedViews as PosedViews
