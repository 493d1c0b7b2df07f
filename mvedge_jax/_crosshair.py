"""The crosshair of a light field as planes whose last axis is the epipolar one."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float

from mvedge_jax.lightfield import LightField


class Arm(NamedTuple):
    """One arm of the crosshair; of the vertical arm, images are transposed.

    Attributes:
        planes: views as color planes, `[s, c, y, x]`, sRGB, the last axis along the arm.
        steps: view steps from the center view to each view, the factor of disparity, `[s]`.
        available: which views are there, `[s]`.
    """

    planes: Float[Array, "s c y x"]
    steps: Float[Array, " s"]
    available: Bool[Array, " s"]

    @property
    def center(self) -> int:
        """Index of the center view."""
        return self.planes.shape[0] // 2


class Crosshair(NamedTuple):
    """The row and the column of views through a view; images of the column are transposed."""

    horizontal: Arm
    vertical: Arm

    @property
    def center(self) -> Float[Array, "c y x"]:
        """The view that both have in common."""
        return self.horizontal.planes[self.horizontal.center]

    def mapped(self, function: Callable[[Array], Array]) -> "Crosshair":
        """The same with a function applied to the planes of both arms."""
        horizontal, vertical = (arm._replace(planes=function(arm.planes)) for arm in self)
        return Crosshair(horizontal, vertical)


def view_steps(count: int, dtype: DTypeLike) -> Float[Array, " s"]:
    """View steps from the center view to each view of a regular arm, the factors of disparity.

    They fall from the first view to the last one; the center view is number `count // 2`.
    """
    return jnp.asarray(count // 2 - np.arange(count), dtype)


def crosshair(light_field: LightField) -> Crosshair:
    """The horizontal and the vertical arm; the vertical one holds transposed images.

    Views are read as if they were on the center row and column; `LightField` sees to it that they
    are not far beside them.
    """
    (vc, uc), steps = light_field.center, light_field.steps
    horizontal = jnp.transpose(light_field.horizontal_arm, (0, 3, 1, 2))
    vertical = jnp.transpose(light_field.vertical_arm, (0, 3, 2, 1))
    return Crosshair(
        Arm(horizontal, steps[vc, :, 0], light_field.available[vc]),
        Arm(vertical, steps[:, uc, 1], light_field.available[:, uc]),
    )
