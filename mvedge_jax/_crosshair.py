"""The crosshair of a light field as planes whose last axis is the epipolar one."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from mvedge_jax.lightfield import LightField


class Arm(NamedTuple):
    """One arm of the crosshair; of the vertical arm, images are transposed.

    Attributes:
        planes: views as colour planes, `[s, c, y, x]`, sRGB, the last axis along the arm.
        steps: disparity is multiplied by this to get from the centre view to each view, `[s]`.
        available: which views are there, `[s]`.
    """

    planes: Float[Array, "s c y x"]
    steps: Float[Array, " s"]
    available: Bool[Array, " s"]

    @property
    def centre(self) -> int:
        """Index of the centre view."""
        return self.planes.shape[0] // 2


def crosshair(light_field: LightField) -> tuple[Arm, Arm]:
    """The horizontal and the vertical arm; the vertical one holds transposed images."""
    vc, uc = light_field.centre
    dtype = light_field.views.dtype
    horizontal = jnp.transpose(light_field.horizontal_arm, (0, 3, 1, 2))
    vertical = jnp.transpose(light_field.vertical_arm, (0, 3, 2, 1))

    def steps(count: int, centre: int) -> Array:
        return jnp.asarray(centre - np.arange(count), dtype)

    return (
        Arm(horizontal, steps(horizontal.shape[0], uc), light_field.available[vc]),
        Arm(vertical, steps(vertical.shape[0], vc), light_field.available[:, uc]),
    )
