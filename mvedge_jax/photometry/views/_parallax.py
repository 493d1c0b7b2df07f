"""Positions of a pixel in other views: by a grid step, or by a homography and an epipole."""

from typing import NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._root import safe_sqrt

# Guards divisions for views that see a surface almost edge-on.
_BEHIND = 1e-3


@runtime_checkable
class Parallax(Protocol):
    """Positions of the reference view's pixels in a view, or in each view of a stack.

    A pytree of arrays, with a leading axis for a stack; loops take one view at a time. All results
    but `seen` are differentiable.
    """

    @property
    def apart(self) -> Float[Array, "*s"]:
        """Distance from the reference view, in view steps or baselines; 0 for the reference."""
        ...

    def positions(self, disparity: Float[Array, "y x"]) -> tuple[Array, Array]:
        """Columns and rows at which the view shows the pixels, px, `[y, x]` each."""
        ...

    def steps(self, disparity: Float[Array, "y x"]) -> tuple[Array, Array]:
        """Movement of the pixel itself that is equivalent to a change of disparity by 1."""
        ...

    def pulled(
        self, disparity: Float[Array, "y x"], slopes: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """Converts derivatives along the view's axes to those along the reference view's."""
        ...

    def seen(
        self, disparity: Float[Array, "y x"], radius: int, *, slant: Float[Array, ""] | float = 0.05
    ) -> Bool[Array, "y x"]:
        """Pixels within the view's frame that no other pixel within `radius` px hides.

        Differences of disparity below `slant`, px, are not occlusions.
        """
        ...


class GridShift(NamedTuple):
    """A view of a grid: a pixel moves there by its disparity times the step of the view.

    Attributes:
        step: `(u_c - u, v_c - v)`, or minus the view's position.
    """

    step: Float[Array, "*s 2"]

    @property
    def apart(self) -> Float[Array, "*s"]:
        """See `Parallax`."""
        return safe_sqrt(jnp.sum(self.step**2, axis=-1))

    def positions(self, disparity: Float[Array, "y x"]) -> tuple[Array, Array]:
        """See `Parallax`."""
        height, width = disparity.shape
        x = jnp.arange(width, dtype=disparity.dtype)[None] + self.step[0] * disparity
        y = jnp.arange(height, dtype=disparity.dtype)[:, None] + self.step[1] * disparity
        return x, y

    def steps(self, disparity: Float[Array, "y x"]) -> tuple[Array, Array]:
        """See `Parallax`."""
        return self.step[0], self.step[1]

    def pulled(
        self, disparity: Float[Array, "y x"], slopes: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """See `Parallax`."""
        return slopes

    def seen(
        self, disparity: Float[Array, "y x"], radius: int, *, slant: Float[Array, ""] | float = 0.05
    ) -> Bool[Array, "y x"]:
        """See `Parallax`.

        A pixel `j` px away, against the direction of the view's step, hides another if its
        disparity is larger by `j` over the length of the step, with a tolerance of half a pixel
        and half a step for the size of pixels. `slant` is not needed, because this tolerance is
        larger.
        """
        del slant
        disparity, step = lax.stop_gradient(disparity), self.step
        height, width = disparity.shape
        length = jnp.max(jnp.abs(step))
        direction = step / jnp.where(length > 0, length, 1)
        padded = jnp.pad(disparity, radius, constant_values=-jnp.inf)

        def nearer(hidden: Array, distance: Array) -> tuple[Array, None]:
            apart = distance.astype(disparity.dtype)
            x, y = (jnp.round(apart * d).astype(jnp.int32) for d in direction)
            other = lax.dynamic_slice(padded, (radius - y, radius - x), (height, width))
            return hidden | ((other - disparity) * (length + 0.5) > apart - 0.5), None

        nothing = jnp.zeros(disparity.shape, bool)
        hidden, _ = lax.scan(nearer, nothing, jnp.arange(1, radius + 1))
        return inside(*self.positions(disparity), disparity.shape) & ~(hidden & (length > 0))


class PlaneParallax(NamedTuple):
    """A posed photograph: the pixel `p` at disparity `d` is at `H p + d e`, homogeneous.

    The third coordinate is depth in the view over depth in the reference view, as it is with
    `H = K R K_r^-1` and `e = K t / s`, where `d` is `s` times the inverse depth.

    Attributes:
        homography: `H`, for points at infinity.
        epipole: `e`: times the disparity, where the reference view's camera is seen.
    """

    homography: Float[Array, "*s 3 3"]
    epipole: Float[Array, "*s 3"]

    @property
    def apart(self) -> Float[Array, "*s"]:
        """See `Parallax`."""
        return safe_sqrt(jnp.sum(self.epipole**2, axis=-1))

    def positions(self, disparity: Float[Array, "y x"]) -> tuple[Array, Array]:
        """See `Parallax`; points behind the view's camera are far outside of its frame."""
        (x, y), depth = self._homogeneous(disparity)
        ahead = depth > _BEHIND
        safe = jnp.where(ahead, depth, 1)
        away = jnp.asarray(-1e6, disparity.dtype)
        return jnp.where(ahead, x / safe, away), jnp.where(ahead, y / safe, away)

    def steps(self, disparity: Float[Array, "y x"]) -> tuple[Array, Array]:
        """See `Parallax`: not the movement in the view, which is turned and magnified."""
        (xx, xy, yx, yy), (along_x, along_y) = self._jacobian(disparity)
        determinant = xx * yy - xy * yx
        # A view from behind a surface, or edge-on, has no information.
        usable = jnp.abs(determinant) > _BEHIND
        safe = jnp.where(usable, determinant, 1)
        x, y = (yy * along_x - xy * along_y) / safe, (xx * along_y - yx * along_x) / safe
        return jnp.where(usable, x, 0), jnp.where(usable, y, 0)

    def pulled(
        self, disparity: Float[Array, "y x"], slopes: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """See `Parallax`."""
        (xx, xy, yx, yy), _ = self._jacobian(disparity)
        x, y = slopes
        return xx[None] * x + yx[None] * y, xy[None] * x + yy[None] * y

    def seen(
        self, disparity: Float[Array, "y x"], radius: int, *, slant: Float[Array, ""] | float = 0.05
    ) -> Bool[Array, "y x"]:
        """See `Parallax`.

        Nearness is relative to the view's own camera, from which larger disparities may be farther
        away. All pixels are drawn into the view, which keeps the nearest; gaps of a pixel are
        closed from both sides. Differences below `slant`, px, are not occlusions. `radius` is not
        needed, because any pixel may hide any other.
        """
        disparity = lax.stop_gradient(disparity)
        height, width = disparity.shape
        _, depth = self._homogeneous(disparity)
        x, y = self.positions(disparity)
        ahead = inside(x, y, (height, width)) & (depth > _BEHIND)
        near = disparity / jnp.where(ahead, depth, 1)
        column, row = (jnp.floor(p + 0.5).astype(jnp.int32) for p in (x, y))
        place = jnp.where(ahead, row * width + column, height * width).reshape(-1)
        empty = jnp.full(height * width, -jnp.inf, disparity.dtype)
        front = empty.at[place].max(near.reshape(-1), mode="drop").reshape(height, width)
        front = _closed(_closed(front).T).T
        shown = front.reshape(-1)[jnp.minimum(place, height * width - 1)].reshape(height, width)
        _, (along_x, along_y) = self._jacobian(disparity)
        length = jnp.maximum(jnp.abs(along_x), jnp.abs(along_y))
        slack = 0.5 / (length + 0.5) + slant
        # From the same position, everything is visible.
        return ahead & ~(((shown - near) * depth > slack) & (length > 0))

    def _homogeneous(self, disparity: Array) -> tuple[tuple[Array, Array], Array]:
        height, width = disparity.shape
        column = jnp.arange(width, dtype=disparity.dtype)[None]
        row = jnp.arange(height, dtype=disparity.dtype)[:, None]
        x, y, z = (
            self.homography[i, 0] * column
            + self.homography[i, 1] * row
            + (self.homography[i, 2] + self.epipole[i] * disparity)
            for i in range(3)
        )
        return (x, y), z

    def _jacobian(self, disparity: Array) -> tuple[tuple[Array, ...], tuple[Array, Array]]:
        """Movement in the view with the pixel (xx, xy, yx, yy), and with its disparity."""
        (x, y), depth = self._homogeneous(disparity)
        ahead = depth > _BEHIND
        over = jnp.where(ahead, 1 / jnp.where(ahead, depth, 1), 0)
        x, y = x * over, y * over
        h, e = self.homography, self.epipole
        moved = tuple(
            (h[i, j] - place * h[2, j]) * over for i, place in enumerate((x, y)) for j in (0, 1)
        )
        return moved, ((e[0] - x * e[2]) * over, (e[1] - y * e[2]) * over)


def inside(x: Array, y: Array, shape: tuple[int, ...]) -> Bool[Array, "*p"]:
    """Whether positions are within a frame of `shape` px."""
    height, width = shape
    return (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)


def shown_at(
    shown: Float[Array, "y x"], x: Float[Array, "*p"], y: Float[Array, "*p"]
) -> Bool[Array, "*p"]:
    """Whether the pixels nearest to positions, clipped to the frame, show the scene."""
    height, width = shown.shape
    column, row = (
        jnp.clip(jnp.round(lax.stop_gradient(p)), 0, most - 1).astype(jnp.int32)
        for p, most in ((x, width), (y, height))
    )
    return shown.reshape(-1)[row * width + column] > 0


def _closed(front: Float[Array, "y x"]) -> Float[Array, "y x"]:
    """Closes gaps of one pixel along the rows, where both sides are nearer."""
    padded = jnp.pad(front, ((0, 0), (1, 1)), constant_values=-jnp.inf)
    return jnp.maximum(front, jnp.minimum(padded[:, :-2], padded[:, 2:]))
