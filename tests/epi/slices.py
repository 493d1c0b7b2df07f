"""EPIs and lines that several tests look at."""

import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from mvedge_jax.epi import EpiLines

VIEWS, WIDTH = 9, 64
STEPS = VIEWS // 2 - np.arange(VIEWS)


def epi_lines(position, disparity, confidence=None):
    """Lines that all count, with confidence 1 unless told otherwise."""
    position = jnp.asarray(position, jnp.float64)
    confidence = jnp.ones_like(position) if confidence is None else jnp.asarray(confidence)
    valid = jnp.ones(position.shape, bool)
    return EpiLines(position, jnp.asarray(disparity, jnp.float64), confidence, valid)


def step(position, disparity):
    """Coverage of a half plane to the right of a line, antialiased."""
    x = np.arange(WIDTH)[None]
    return np.clip(x - (position + STEPS * disparity)[:, None] + 0.5, 0, 1)


def smooth(epi):
    """An EPI with colors on its last axis, blurred along x."""
    return ndimage.gaussian_filter(epi, (0, 0.85, 0))
