"""Optional data of a light field: cameras and ground truth."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._params import accepts_numpy, as_number, jax_array


class Camera(eqx.Module):
    """A regular grid of parallel pinhole cameras, sheared so that one distance has disparity 0.

    A point at distance `z` has the disparity
    `d = focal_px * baseline * (1 / z - 1 / focus_distance)` px per view step.

    Attributes:
        focal_px: focal length in pixels of the full-resolution view.
        baseline: distance between neighboring views, meters.
        focus_distance: distance of zero disparity, meters; infinite for unsheared cameras.
    """

    focal_px: Float[Array, ""] = eqx.field(converter=as_number)
    baseline: Float[Array, ""] = eqx.field(converter=as_number)
    focus_distance: Float[Array, ""] = eqx.field(converter=as_number)

    @accepts_numpy
    def depth(self, disparity: Float[Array, "*s"]) -> Float[Array, "*s"]:
        """Distance along the optical axis, meters, of a disparity in px per view step.

        Disparities at or beyond that of infinity give `inf`.
        """
        dtype = disparity.dtype
        scale = (self.focal_px * self.baseline).astype(dtype)
        inverse = disparity / scale + (1.0 / self.focus_distance).astype(dtype)
        return jnp.where(inverse > 0, 1.0 / jnp.where(inverse > 0, inverse, 1.0), jnp.inf)

    @accepts_numpy
    def disparity(self, depth: Float[Array, "*s"]) -> Float[Array, "*s"]:
        """Disparity, px per view step, of a distance in meters."""
        dtype = depth.dtype
        scale = (self.focal_px * self.baseline).astype(dtype)
        return scale * (1.0 / depth - (1.0 / self.focus_distance).astype(dtype))

    def downsample(self, factor: int) -> "Camera":
        """The camera of views whose sides are `factor` times smaller."""
        return Camera(self.focal_px / factor, self.baseline, self.focus_distance)


class GroundTruth(eqx.Module):
    """Ground truth of a scene; never read by the method, only by evaluation.

    Attributes:
        disparity: px per view step, at the center view's pixel centers; 0 where not `valid`.
        valid: where `disparity` is known.
        object_ids: an integer per object of the center view.
        view_disparity: `disparity` of every view.
        view_ids: `object_ids` of every view.
    """

    disparity: Float[Array, "y x"] = eqx.field(converter=jax_array)
    valid: Bool[Array, "y x"] = eqx.field(converter=jax_array)
    object_ids: Int[Array, "y x"] | None = eqx.field(converter=jax_array, default=None)
    view_disparity: Float[Array, "v u y x"] | None = eqx.field(converter=jax_array, default=None)
    view_ids: Int[Array, "v u y x"] | None = eqx.field(converter=jax_array, default=None)

    def crop_views(self, window: tuple[slice, slice]) -> "GroundTruth":
        """Ground truth of the views `[v, u]` within a window of the grid."""
        depths, ids = self.view_disparity, self.view_ids
        return GroundTruth(
            self.disparity,
            self.valid,
            self.object_ids,
            None if depths is None else depths[window],
            None if ids is None else ids[window],
        )

    def downsample(self, factor: int) -> "GroundTruth":
        """Ground truth of views whose sides are `factor` times smaller.

        Disparities are means, known where all of an area is known; ids are those of its middle.
        """
        depths = self.view_disparity
        return GroundTruth(
            areas(self.disparity, factor, 0).mean((1, 3)) / factor,
            areas(self.valid, factor, 0).all((1, 3)),
            _picked(self.object_ids, factor, 0),
            None if depths is None else areas(depths, factor, 2).mean((3, 5)) / factor,
            _picked(self.view_ids, factor, 2),
        )


def areas(image: Array, factor: int, axis: int) -> Array:
    """Axes `y, x` at `axis` and `axis + 1` as `y, factor, x, factor`; what is left over goes."""
    rows, columns = (side // factor for side in image.shape[axis : axis + 2])
    shape = image.shape[:axis] + (rows, factor, columns, factor) + image.shape[axis + 2 :]
    index = (slice(None),) * axis + (slice(rows * factor), slice(columns * factor))
    return image[index].reshape(shape)


def _picked(image: Array | None, factor: int, axis: int) -> Array | None:
    """The middle pixel of every area."""
    if image is None:
        return None
    index = (slice(None),) * axis + (slice(None), factor // 2, slice(None), factor // 2)
    return areas(image, factor, axis)[index]
