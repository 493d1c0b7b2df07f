"""Photographs with known cameras, and the projections of one's pixels into the others."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._params import accepts_numpy
from mvedge_jax._product import product
from mvedge_jax.photometry.views import PlaneParallax

# Allowed error of rotations; files hold six digits.
_RIGID = 1e-3
# Allowed rounding error as a share of the largest baseline.
_ROUNDED = 1e-2


class Photographs(eqx.Module):
    """A few photographs of one size, whose cameras are known.

    Construction checks shapes, and, outside of `jit`, values.

    Attributes:
        images: sRGB in [0, 1], without lens distortion.
        poses: camera to world; x right, y down, z forward; lengths in any unit.
        intrinsics: `[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]` px, centers of pixels at integers.
        points: sparse points in the world, if known.
        observed: which photographs saw which of the points, if known.
        depth: true distance along the optical axis at the pixels' centers, 0 where unknown; never
            read by the method.
        mask: opaque pixels; None for all. Pixels of a transparent background are ignored and get
            no depth.
        names: one per photograph.
        name: name of the scene, for tables and figures.
        origin: offset that was subtracted from cameras and points, in float64, and that
            `mvedge_jax.datasets.exchange` adds again: 0 except for geographic coordinates.

    Raises:
        ValueError: on wrong shapes, fewer than two photographs, values that are not finite or lie
            outside of [0, 1], poses that are not rigid, or so far from the origin that rounding
            shows in their baselines, focal lengths that are not positive, skewed pixels.

    Example:
        >>> import jax.numpy as jnp
        >>> poses = jnp.stack([jnp.eye(4), jnp.eye(4).at[0, 3].set(0.1)])
        >>> matrix = jnp.asarray([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]])
        >>> pair = Photographs(jnp.zeros((2, 12, 16, 3)), poses, matrix)
        >>> pair.intrinsics.shape, pair.names
        ((2, 3, 3), ('0', '1'))
    """

    images: Float[Array, "n y x 3"]
    poses: Float[Array, "n 4 4"]
    intrinsics: Float[Array, "n 3 3"]
    points: Float[Array, "m 3"] | None
    observed: Bool[Array, "n m"] | None
    depth: Float[Array, "n y x"] | None
    mask: Bool[Array, "n y x"] | None
    names: tuple[str, ...] = eqx.field(static=True)
    name: str = eqx.field(static=True)
    origin: tuple[float, float, float] = eqx.field(static=True)

    def __init__(
        self,
        images: Any,
        poses: Any,
        intrinsics: Any,
        *,
        points: Any = None,
        observed: Any = None,
        depth: Any = None,
        mask: Any = None,
        names: tuple[str, ...] | None = None,
        name: str = "photographs",
        origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ):
        self.images = jnp.asarray(images)
        dtype = self.images.dtype
        self.poses = jnp.asarray(poses, dtype)
        matrix = jnp.asarray(intrinsics, dtype)
        if matrix.ndim == 2:
            matrix = jnp.broadcast_to(matrix[None], (self.images.shape[0], *matrix.shape))
        self.intrinsics = matrix
        self.points = None if points is None else jnp.asarray(points, dtype)
        self.observed = None if observed is None else jnp.asarray(observed, bool)
        self.depth = None if depth is None else jnp.asarray(depth, dtype)
        self.mask = None if mask is None else jnp.asarray(mask, bool)
        count = self.images.shape[0] if self.images.ndim else 0
        self.names = tuple(str(i) for i in range(count)) if names is None else tuple(names)
        self.name = name
        self.origin = origin

    def __check_init__(self):
        images = self.images
        if images.ndim != 4 or images.shape[-1] != 3 or min(images.shape) < 1:
            raise ValueError(f"`images` must have the axes [n, y, x, 3], got shape {images.shape}.")
        if images.dtype not in (jnp.float32, jnp.float64):
            raise ValueError(f"`images` must be float32 or float64 in [0, 1], got {images.dtype}.")
        n, height, width, _ = images.shape
        if n < 2:
            raise ValueError("`images` must hold at least two photographs, got one.")
        if min(height, width) < 8:
            raise ValueError(f"`images` must be at least 8 px a side, got {height}x{width}.")
        wanted: dict[str, tuple[int, ...]] = {"poses": (n, 4, 4), "intrinsics": (n, 3, 3)}
        if self.depth is not None:
            wanted["depth"] = (n, height, width)
        if self.mask is not None:
            wanted["mask"] = (n, height, width)
        if self.points is not None:
            wanted["points"] = (self.points.shape[0], 3) if self.points.ndim else (0, 3)
            if self.observed is not None:
                wanted["observed"] = (n, self.points.shape[0])
        for name, shape in wanted.items():
            found = getattr(self, name).shape
            if found != shape:
                raise ValueError(f"`{name}` must have the shape {shape}, got {found}.")
        if len(self.names) != n or len(set(self.names)) != n:
            raise ValueError(
                f"`names` must be {n} different names, one per photograph, got {self.names}."
            )
        if not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(self)):
            self._check_values()

    def _check_values(self) -> None:
        for name in ("images", "poses", "intrinsics", "points"):
            value = getattr(self, name)
            if value is not None and not bool(jnp.isfinite(value).all()):
                raise ValueError(f"`{name}` must be finite, got NaN or infinity.")
        centers = np.asarray(self.centers, np.float64)
        apart = float(np.linalg.norm(centers - centers[0], axis=1).max())
        away = float(np.abs(centers).max())
        if float(jnp.finfo(self.poses.dtype).eps) * away > _ROUNDED * apart > 0:
            raise ValueError(
                f"`poses` lie up to {away:.6g} from the origin and {apart:.4g} from each other, "
                f"which {self.poses.dtype} cannot tell; subtract the mean of the cameras' centers."
            )
        low, high = float(self.images.min()), float(self.images.max())
        if low < -1e-3 or high > 1 + 1e-3:
            raise ValueError(f"`images` must be sRGB in [0, 1], got {low:.4g} to {high:.4g}.")
        for own, pose, matrix in zip(
            self.names, np.asarray(self.poses), np.asarray(self.intrinsics), strict=True
        ):
            turn = pose[:3, :3].astype(np.float64)
            rigid = np.abs(turn @ turn.T - np.eye(3)).max() < _RIGID and np.linalg.det(turn) > 0
            if not rigid or np.abs(pose[3] - [0, 0, 0, 1]).max() > _RIGID:
                raise ValueError(
                    f"`poses` must be rigid, a rotation and a shift, but that of {own} is not; its "
                    f"determinant is {np.linalg.det(turn):.4g}."
                )
            if min(matrix[0, 0], matrix[1, 1]) <= 0 or np.abs(matrix[2] - [0, 0, 1]).max() > 1e-6:
                raise ValueError(
                    "`intrinsics` must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with positive fx "
                    f"and fy, but those of {own} are {matrix.tolist()}."
                )
            if abs(matrix[0, 1]) + abs(matrix[1, 0]) > 1e-3 * matrix[0, 0]:
                raise ValueError(f"`intrinsics` of {own} have skewed pixels, which is not handled.")

    @property
    def centers(self) -> Float[Array, "n 3"]:
        """Positions of the cameras in the world."""
        return self.poses[:, :3, 3]

    def index(self, name: str) -> int:
        """Index of a photograph by its name, with or without the file's ending.

        Args:
            name: as in `names`.

        Returns:
            The index.

        Raises:
            ValueError: no photograph, or more than one, has this name.
        """
        if name in self.names:
            return self.names.index(name)
        found = [i for i, own in enumerate(self.names) if own.rsplit(".", 1)[0] == name]
        if len(found) != 1:
            some = ", ".join(self.names[:8]) + (", ..." if len(self.names) > 8 else "")
            raise ValueError(f"no photograph is called {name!r}; there are {some}.")
        return found[0]

    def without_truth(self) -> "Photographs":
        """Copy without ground truth."""
        return eqx.tree_at(lambda p: p.depth, self, None, is_leaf=lambda leaf: leaf is None)

    def point_depths(self, index: int) -> Float[np.ndarray, " k"]:
        """Distances along a photograph's axis of the points that it saw, on the host.

        Args:
            index: index of the photograph.

        Returns:
            Distances of the points in front of the camera and inside of the frame; empty without
            points.
        """
        if self.points is None:
            return np.zeros(0)
        pose = np.asarray(self.poses[index], np.float64)
        local = (np.asarray(self.points, np.float64) - pose[:3, 3]) @ pose[:3, :3]
        if self.observed is not None and bool(self.observed[index].any()):
            local = local[np.asarray(self.observed[index])]
        local = local[local[:, 2] > 0]
        place = local @ np.asarray(self.intrinsics[index], np.float64).T
        x, y = place[:, 0] / place[:, 2], place[:, 1] / place[:, 2]
        height, width = self.images.shape[1:3]
        inside = (x >= -0.5) & (x <= width - 0.5) & (y >= -0.5) & (y <= height - 0.5)
        return local[inside, 2]


@accepts_numpy
def projections(
    poses: Float[Array, "n 4 4"],
    intrinsics: Float[Array, "n 3 3"],
    reference: Int[Array, ""] | int,
    scale: Float[Array, ""],
) -> PlaneParallax:
    r"""Positions of one photograph's pixels in all photographs.

    $\lambda q = K R K_r^{-1} p + d\,K t / s$, with $R$ and $t$ the motion from the reference
    camera to the other and $d = s / z$ the disparity; $\lambda$ is the depth there over that here.

    Args:
        poses: camera to world.
        intrinsics: px.
        reference: index of the photograph whose pixels are projected.
        scale: disparity times depth, px times the poses' unit.

    Returns:
        One projection per photograph, in their order. Differentiable in all but `reference`.

    Example:
        >>> import jax.numpy as jnp
        >>> poses = jnp.stack([jnp.eye(4), jnp.eye(4).at[0, 3].set(0.1)])
        >>> matrix = jnp.broadcast_to(jnp.diag(jnp.asarray([20.0, 20.0, 1.0])), (2, 3, 3))
        >>> projections(poses, matrix, 0, jnp.asarray(2.0)).epipole[1].round(6).tolist()
        [-1.0, 0.0, 0.0]
    """
    own, matrix = poses[reference], intrinsics[reference]
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    nothing, one = jnp.zeros_like(fx), jnp.ones_like(fx)
    inverse = jnp.stack(
        [1 / fx, nothing, -cx / fx, nothing, 1 / fy, -cy / fy, nothing, nothing, one]
    )

    def of(pose: Array, matrix: Array) -> PlaneParallax:
        turn = product(pose[:3, :3].T, own[:3, :3])
        shift = product(pose[:3, :3].T, own[:3, 3] - pose[:3, 3])
        homography = product(product(matrix, turn), inverse.reshape(3, 3))
        return PlaneParallax(homography, product(matrix, shift) / scale)

    found = jax.vmap(of)(poses, intrinsics)
    # Exact identity, so that rounding does not move the reference's border out of its frame.
    identity = found.homography.at[reference].set(jnp.eye(3, dtype=poses.dtype))
    return PlaneParallax(identity, found.epipole.at[reference].set(0))
