"""Photometry: what the colours of the views say, once noise and brightness are understood."""

from ._denoise import Smoothed as Smoothed, denoised as denoised, low_pass as low_pass
from ._exposure import (
    Exposure as Exposure,
    expose as expose,
    exposure_along as exposure_along,
    rough_exposure as rough_exposure,
)
from ._noise import Noise as Noise, measure_noise as measure_noise
from ._pooling import pooled as pooled
