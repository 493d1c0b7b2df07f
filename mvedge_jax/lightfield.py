"""The light field: a grid of views, optional metadata, and the slices that the method reads."""

import dataclasses
from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from mvedge_jax._checks import check_finite
from mvedge_jax._known import Camera as Camera, GroundTruth as GroundTruth, areas
from mvedge_jax._params import as_number
from mvedge_jax._positions import check_positions, farthest


class LightField(eqx.Module):
    """A grid of views `views[v, u, y, x, c]`.

    `v` counts view rows from the top, `u` view columns from the left. A point at `(x, y)` of the
    center view with disparity `d` is at `(x - p_x d, y - p_y d)` in a view at the position
    `(p_x, p_y)`, which is `(u - u_c, v - v_c)` on a regular grid; larger `d` is nearer.

    Construction checks shapes, and, outside of `jit`, values. Not every view has to be there: the
    crosshair (the center row and the center column of views) is enough for the center view, and
    it may have gaps.

    Attributes:
        views: sRGB in [0, 1]; zero where a view is missing.
        available: which views are there.
        positions: of all views, missing ones as well, from the center view: columns (to the right),
            then rows (down), in view steps; None for a regular grid of square cells. Columns may be
            uneven, and rows closer or farther apart than columns.
        disparity_range: lowest and highest disparity of the scene, px per view step, if known.
        truth: ground truth if known; `without_truth` drops it.
        camera: the cameras' geometry if known.
        name: what to call the scene in tables and figures.

    Raises:
        ValueError: on a wrong rank, an even number of views per side, values that are not finite or
            lie outside [0, 1], a center view that is missing or alone on its row and column,
            positions that are none of rows and columns of views, an empty disparity range, or
            ground truth of another size.

    Example:
        >>> import jax.numpy as jnp
        >>> light_field = LightField(jnp.zeros((3, 3, 8, 8, 3)))
        >>> light_field.center
        (1, 1)
        >>> light_field.horizontal_epis().shape
        (8, 3, 8, 3)
    """

    views: Float[Array, "v u y x c"]
    available: Bool[Array, "v u"]
    positions: Float[Array, "v u 2"] | None
    disparity_range: Float[Array, "2"] | None
    truth: GroundTruth | None
    camera: Camera | None
    name: str = eqx.field(static=True)

    def __init__(
        self,
        views: Any,
        *,
        available: Any = None,
        positions: Any = None,
        disparity_range: Any = None,
        truth: GroundTruth | None = None,
        camera: Camera | None = None,
        name: str = "light field",
    ):
        self.views = jnp.asarray(views)
        if self.views.ndim != 5:
            raise ValueError(
                "`views` must have the axes [v, u, y, x, c] (5 of them), got shape "
                f"{self.views.shape}."
            )
        grid = self.views.shape[:2]
        self.available = (
            jnp.ones(grid, bool) if available is None else jnp.asarray(available, dtype=bool)
        )
        dtype = self.views.dtype
        self.positions = None if positions is None else jnp.asarray(positions, dtype)
        self.disparity_range = None if disparity_range is None else as_number(disparity_range)
        self.truth = truth
        self.camera = camera
        self.name = name

    def __check_init__(self):
        views, grid = self.views, self.views.shape[:2]
        if not jnp.issubdtype(views.dtype, jnp.floating):
            raise ValueError(
                f"`views` must be floating point, sRGB in [0, 1], got {views.dtype}; divide 8-bit "
                "images by 255."
            )
        if views.dtype not in (jnp.float32, jnp.float64):
            raise ValueError(
                f"`views` must be float32 or float64, got {views.dtype}, whose precision does not "
                "suffice; `views.astype(jnp.float32)` will do."
            )
        if views.shape[-1] != 3:
            raise ValueError(f"`views` must have three color channels, got {views.shape[-1]}.")
        if min(views.shape) < 1:
            raise ValueError(f"`views` must not be empty, got shape {views.shape}.")
        if grid[0] % 2 == 0 or grid[1] % 2 == 0:
            raise ValueError(
                "`views` must have an odd number of view rows and columns, so that there is a "
                f"center view, got a grid of {grid[0]}x{grid[1]}; crop it (for example `views=7`)."
            )
        if self.available.shape != grid:
            raise ValueError(
                f"`available` must have the shape of the view grid {grid}, got "
                f"{self.available.shape}."
            )
        if self.positions is not None and self.positions.shape != (*grid, 2):
            raise ValueError(
                "`positions` must have the columns and rows of every view, of shape "
                f"{(*grid, 2)}, got {self.positions.shape}."
            )
        if self.disparity_range is not None and self.disparity_range.shape != (2,):
            raise ValueError(
                "`disparity_range` must be a pair (low, high), got shape "
                f"{self.disparity_range.shape}."
            )
        if self.truth is not None and self.truth.disparity.shape != views.shape[2:4]:
            raise ValueError(
                "`truth.disparity` must have the size of the views, "
                f"{views.shape[2]}x{views.shape[3]}, got {self.truth.disparity.shape}."
            )
        if not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(self)):
            self._check_values()

    def _check_values(self) -> None:
        available = np.asarray(self.available)
        vc, uc = self.center
        if not available[vc, uc]:
            raise ValueError(
                f"`available` must include the center view, (v, u) = ({vc}, {uc}), which is "
                "missing."
            )
        if available.size > 1 and available[vc].sum() + available[:, uc].sum() == 2:
            raise ValueError(
                "`available` must include a view of the crosshair, the center row and column of "
                f"views, besides the center view; all {sum(available.shape) - 2} are missing."
            )
        if self.positions is not None:
            check_positions(np.asarray(self.positions))
        check_finite(self.views)
        low, high = float(self.views.min()), float(self.views.max())
        if low < -1e-3 or high > 1 + 1e-3:
            raise ValueError(
                f"`views` must be sRGB in [0, 1], got values from {low:.4g} to {high:.4g}."
            )
        if self.disparity_range is not None:
            start, stop = np.asarray(self.disparity_range)
            if not (np.isfinite(start) and np.isfinite(stop) and start < stop):
                raise ValueError(
                    "`disparity_range` must be finite with low < high, got "
                    f"({start:.4g}, {stop:.4g})."
                )
        if self.truth is not None:
            disparity = np.asarray(self.truth.disparity)
            if not np.isfinite(disparity[np.asarray(self.truth.valid)]).all():
                raise ValueError("`truth.disparity` must be finite where `truth.valid` is set.")

    @property
    def center(self) -> tuple[int, int]:
        """`(v_c, u_c)`, the indices of the center view."""
        return self.views.shape[0] // 2, self.views.shape[1] // 2

    @property
    def center_view(self) -> Float[Array, "y x c"]:
        """The center view, sRGB in [0, 1]."""
        vc, uc = self.center
        return self.views[vc, uc]

    @property
    def steps(self) -> Float[Array, "v u 2"]:
        """Minus the position of every view: what the disparity is multiplied by to get there.

        On a regular grid `(u_c - u, v_c - v)`.
        """
        if self.positions is not None:
            return 0 - self.positions
        vc, uc = self.center
        dv, du = np.mgrid[vc : vc - self.views.shape[0] : -1, uc : uc - self.views.shape[1] : -1]
        return jnp.asarray(np.stack([du, dv], axis=-1), self.views.dtype)

    @property
    def farthest(self) -> int:
        """View steps from the center view to the outermost one along either axis, rounded up.

        Sizes are chosen from it on the host.

        Raises:
            TypeError: the positions are traced.
        """
        return max(self.center) if self.positions is None else farthest(self.positions)

    @property
    def horizontal_arm(self) -> Float[Array, "u y x c"]:
        """The center row of views."""
        return self.views[self.center[0]]

    @property
    def vertical_arm(self) -> Float[Array, "v y x c"]:
        """The center column of views."""
        return self.views[:, self.center[1]]

    def horizontal_epis(self) -> Float[Array, "y u x c"]:
        """One epipolar-plane image per image row `y`: `E[u, x] = views[v_c, u, y, x]`."""
        return jnp.swapaxes(self.horizontal_arm, 0, 1)

    def vertical_epis(self) -> Float[Array, "x v y c"]:
        """One epipolar-plane image per image column `x`: `E[v, y] = views[v, u_c, y, x]`."""
        return jnp.transpose(self.vertical_arm, (2, 0, 1, 3))

    def _with(self, **changes: Any) -> "LightField":
        """The same light field with some fields of other values, which are checked."""
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return LightField(**{**fields, **changes})

    def without_truth(self) -> "LightField":
        """Copy without ground truth."""
        return eqx.tree_at(lambda s: s.truth, self, None, is_leaf=lambda leaf: leaf is None)

    def with_range(self, low: float, high: float) -> "LightField":
        """Copy with another disparity range, px per view step, which is checked."""
        return self._with(disparity_range=(low, high))

    def renamed(self, name: str) -> "LightField":
        """The same light field by another name."""
        # Values are not checked again: those on a device would have to be read back.
        like = jax.eval_shape(lambda s: s._with(name=name), self)
        return jax.tree.unflatten(jax.tree.structure(like), jax.tree.leaves(self))

    def bare(self) -> "LightField":
        """The views, their positions, and which of them are there: all that depth comes from.

        `EdgeDepth` and its like are compiled for it, so that what else is known about a scene,
        or whether it is, compiles nothing anew.
        """
        plain = eqx.tree_at(
            lambda s: (s.disparity_range, s.truth, s.camera),
            self,
            (None, None, None),
            is_leaf=lambda leaf: leaf is None,
        )
        return plain.renamed("")

    def crop_views(self, rows: int, columns: int | None = None) -> "LightField":
        """Keeps the central `rows` x `columns` views (`columns` defaults to `rows`).

        Raises:
            ValueError: if a number is even, below 1, or larger than the grid.
        """
        columns = rows if columns is None else columns
        for label, count, have in zip(
            ("rows", "columns"), (rows, columns), self.views.shape[:2], strict=True
        ):
            if count % 2 == 0 or not 1 <= count <= have:
                raise ValueError(
                    f"`{label}` must be odd and between 1 and the {have} views there are, got "
                    f"{count}."
                )
        vc, uc = self.center
        window = (
            slice(vc - rows // 2, vc + rows // 2 + 1),
            slice(uc - columns // 2, uc + columns // 2 + 1),
        )
        return self._with(
            views=self.views[window],
            available=self.available[window],
            positions=None if self.positions is None else self.positions[window],
            truth=None if self.truth is None else self.truth.crop_views(window),
        )

    def without_views(self, places: Iterable[tuple[int, int]]) -> "LightField":
        """The same light field in which some views are missing.

        Args:
            places: `(v, u)` of each, such as `datasets.find_dead_views` finds.

        Raises:
            ValueError: a place is not in the grid, or what is left has no center view or nothing
                else on the crosshair.

        Example:
            >>> import jax.numpy as jnp
            >>> light_field = LightField(jnp.ones((3, 3, 8, 8, 3))).without_views([(1, 2)])
            >>> bool(light_field.available[1, 2]), float(light_field.views[1, 2].max())
            (False, 0.0)
        """
        gone = np.zeros(self.available.shape, bool)
        for v, u in places:
            if not (0 <= v < gone.shape[0] and 0 <= u < gone.shape[1]):
                raise ValueError(
                    f"`places` names view (v, u) = ({v}, {u}), which is not in the grid of "
                    f"{gone.shape[0]}x{gone.shape[1]} views."
                )
            gone[v, u] = True
        if not gone.any():
            return self
        return self._with(
            views=jnp.where(
                gone[..., None, None, None], jnp.zeros((), self.views.dtype), self.views
            ),
            available=self.available & ~gone,
        )

    def downsample(self, factor: int) -> "LightField":
        """Shrinks every view by averaging `factor` x `factor` areas.

        Disparities shrink with the pixels. Ground truth is averaged too (known only where all
        of an area is known); object ids are those of the area's center pixel. Rows and columns that
        do not fill an area are dropped at the bottom and right.

        Raises:
            ValueError: if `factor` is below 1 or larger than a side of the views.
        """
        height, width = self.views.shape[2:4]
        if not 1 <= factor <= min(height, width):
            raise ValueError(
                f"`factor` must be between 1 and the shorter side, {min(height, width)} px, got "
                f"{factor}."
            )
        if factor == 1:
            return self
        return self._with(
            views=areas(self.views, factor, 2).mean((3, 5)),
            disparity_range=None if self.disparity_range is None else self.disparity_range / factor,
            truth=None if self.truth is None else self.truth.downsample(factor),
            camera=None if self.camera is None else self.camera.downsample(factor),
        )
