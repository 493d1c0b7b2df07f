"""The crosshair of a light field as planes whose last axis is the epipolar one."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
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


def view_steps(count: int, dtype: DTypeLike) -> Float[Array, " s"]:
    """What disparity is multiplied by to get from the centre view to each view of an arm.

    Args:
        count: views of the arm; the centre one is number `count // 2`.
        dtype: of the result.

    Returns:
        From the first view to the last one, falling.
    """
    return jnp.asarray(count // 2 - np.arange(count), dtype)


def crosshair(light_field: LightField) -> tuple[Arm, Arm]:
    """The horizontal and the vertical arm; the vertical one holds transposed images."""
    vc, uc = light_field.centre
    dtype = light_field.views.dtype
    horizontal = jnp.transpose(light_field.horizontal_arm, (0, 3, 1, 2))
    vertical = jnp.transpose(light_field.vertical_arm, (0, 3, 2, 1))

    return (
        Arm(horizontal, view_steps(horizontal.shape[0], dtype), light_field.available[vc]),
        Arm(vertical, view_steps(vertical.shape[0], dtype), light_field.available[:, uc]),
    )
