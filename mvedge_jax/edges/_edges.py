"""Edge points: positions by the oriented filter bank, disparities by the measurement."""

from typing import Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float, PRNGKeyArray

from mvedge_jax._params import at_least, cast, number
from mvedge_jax.color import srgb_to_gray, srgb_to_lab
from mvedge_jax.epi import FilterBank, bank_radius, prewitt_bank, strongest_response
from mvedge_jax.image import highest, highest_beside, unit_gradient
from mvedge_jax.photometry import Evidence
from mvedge_jax.photometry.measuring import PhotometricLabels

from ._candidates import contrast, find_candidates, subpixel
from ._points import EdgePoints, Edges, EdgeStats


@runtime_checkable
class EdgeDetector(Protocol):
    """Finds edge points; called inside `jit`.

    Slots that are not valid hold zeros. Selections are discrete, values differentiable.
    """

    def __call__(self, evidence: Evidence, *, key: PRNGKeyArray | None = None) -> Edges:
        """Finds the points of the center view.

        Args:
            evidence: calibrated views and measurement.
            key: random key, for detectors that need one.

        Returns:
            Points and statistics.
        """
        ...


class OrientedEdges(eqx.Module):
    """Edges by oriented Prewitt filters (Thesis 4.1.1), their disparity by the measurement.

    A bank of filters gives edge strength and position along every horizontal and vertical EPI.
    Local maxima along either direction become points, one per pixel; so do those of the center
    view's own contrast, to find lines that cross a stronger one. Points that the views do not
    determine are dropped, in place of Thesis 4.1.3 and 4.1.5.

    Attributes:
        first: index of the first filter: its disparity is `first * spacing`.
        filters: number of filters.
        capacity: slots for points.
        spacing: spacing of the filters, px per view step.
        farthest: view steps from the center view to the outermost one of a light field that comes
            with `positions`; None for a regular grid.
        banks: filters of the horizontal and of the vertical arm; None for Prewitt filters. Give
            them (`prewitt`) to learn them.
        strength_floor: weakest edge considered in a scene without noise.
        above_noise: the same as a multiple of the noise; without it, half of all pixels would be
            edges.
        error_limit: largest standard error of an accepted point in a scene without noise. Large,
            because each point is weighted by its own error, and borders of plain surfaces have no
            better points. It grows in proportion to noise.
        error_noise: how fast the limit grows with noise: the standard deviation of a gray value
            over that of its three channels.
        darkest: lightness that some pixel of the 5x5 around a point must exceed: two of 255 steps,
            as in the vignetted corners of a lenslet camera.
        half_confidence: strength at which the confidence is one half.
        deviation: largest squared difference of a view from the others, in multiples of their own
            variance, at which the view shows a point.
    """

    first: int = eqx.field(static=True)
    filters: int = eqx.field(static=True)
    capacity: int = eqx.field(static=True)
    spacing: float = eqx.field(static=True, default=0.1)
    farthest: int | None = eqx.field(static=True, default=None)
    banks: tuple[FilterBank, FilterBank] | None = None
    strength_floor: Float[Array, ""] = number(0.1, "CIELAB/px", threshold=True)
    above_noise: Float[Array, ""] = number(3.0, "noise deviations", threshold=True)
    error_limit: Float[Array, ""] = number(0.1, "px", threshold=True)
    error_noise: Float[Array, ""] = number(0.65, "1/gray levels of 100", threshold=True)
    darkest: Float[Array, ""] = number(0.8, "L* of 100", threshold=True)
    half_confidence: Float[Array, ""] = number(2.0, "CIELAB/px")
    deviation: Float[Array, ""] = number(2.5, "variances", threshold=True)

    def __check_init__(self) -> None:
        if not self.spacing > 0:
            raise ValueError(f"`spacing` must be positive, got {self.spacing}.")
        at_least(self, filters=3, capacity=1)
        if self.farthest is not None:
            at_least(self, farthest=1)

    @property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest disparity of the filters, px per view step."""
        return self.first * self.spacing, (self.first + self.filters - 1) * self.spacing

    @property
    def searched(self) -> tuple[float, float]:
        """Lowest and highest disparity of the scene: the range less one filter at either end."""
        low, high = self.ends
        return low + self.spacing, high - self.spacing

    def prewitt(
        self,
        views: tuple[int, ...],
        dtype: DTypeLike = jnp.float32,
        *,
        steps: tuple[Float[Array, " u"], Float[Array, " v"]] | None = None,
    ) -> tuple[FilterBank, FilterBank]:
        """The Prewitt filters: the default, and the start for learning filters.

        Args:
            views: a shape that begins with the rows and columns of the grid of views.
            dtype: dtype of the filters.
            steps: view steps from the center view to the views of the horizontal and the vertical
                arm, at most `farthest`, for a light field with `positions`.

        Returns:
            The bank of the horizontal arm and that of the vertical one.

        Example:
            >>> edges = OrientedEdges(first=-2, filters=5, capacity=64)
            >>> across, down = edges.prewitt((3, 9))
            >>> across.taps.shape[:2], down.taps.shape[:2]
            ((5, 9), (5, 3))
        """
        index = self.first + jnp.arange(self.filters, dtype=jnp.int32)
        disparity = index.astype(dtype) * self.spacing
        reach = max(map(abs, self.ends))
        longest = max(views[:2]) // 2 if steps is None else _longest(self, max(views[:2]))
        radius = bank_radius(reach, 2 * longest + 1)
        own = (None, None) if steps is None else (arm.astype(dtype) for arm in steps)
        across, down = (
            prewitt_bank(disparity, count, radius, steps=arm)
            for count, arm in zip(views[1::-1], own, strict=True)
        )
        return across, down

    def __call__(self, evidence: Evidence, *, key: PRNGKeyArray | None = None) -> Edges:
        """See `EdgeDetector`; the evidence needs a measurement."""
        del key
        return _measured_edges(evidence, self)


def _longest(params: OrientedEdges, views: int) -> int:
    """View steps from the center view to the outermost one of an arm of so many views."""
    return views // 2 if params.farthest is None else params.farthest


def _frontmost(
    measured: PhotometricLabels, limit: Array, step: float
) -> tuple[Float[Array, "y x"], Float[Array, "y x"]]:
    """Labels and variances; on the border of two surfaces, those of the nearer one.

    A border belongs to the nearer surface, but its pixels show half of either, so a pixel of the
    surface beside it is measured better. Surfaces less than `step` apart, px per view step, count
    as one; labels with a variance beyond `limit` are ignored.
    """
    own, variance = measured.disparity, measured.variance
    front, sure = highest_beside(jnp.where(variance < limit, own, -jnp.inf), variance)
    nearer = (front > own + step) & (variance > 2 * sure)
    return jnp.where(nearer, front, own), jnp.where(nearer, sure, variance)


def _measured_edges(evidence: Evidence, params: OrientedEdges) -> Edges:
    """Points from measured evidence."""
    scene, measured, shown = evidence.calibrated, evidence.measured, evidence.shown
    if measured is None or shown is None:
        raise ValueError("`OrientedEdges` need a `measurement` in the chain, got None.")
    noise, view = scene.noise, jnp.moveaxis(scene.views.center, 0, -1)
    across, down = (srgb_to_lab(jnp.moveaxis(arm.planes, 1, -1)) for arm in scene.arms)
    params = cast(params, view.dtype)
    banks = params.banks
    if banks is None:
        steps = None
        if params.farthest is not None:
            steps = scene.arms[0].steps, scene.arms[1].steps
        banks = params.prewitt((down.shape[0], across.shape[0]), view.dtype, steps=steps)
    strength = jnp.stack(
        [strongest_response(across, banks[0]), strongest_response(down, banks[1]).T]
    )
    center = contrast(srgb_to_lab(view))
    grain = 100 * noise.deviation
    floor = params.strength_floor + params.above_noise * noise.alpha * grain
    # A single view is noisier than what a filter averages.
    center_floor = floor + params.above_noise * grain
    candidates = find_candidates(strength, center, floor, center_floor, capacity=params.capacity)
    row, column = candidates.row, candidates.column

    limit = params.error_limit * jnp.sqrt(1 + noise.alpha * (params.error_noise * grain) ** 2)
    step = 2 / max(_longest(params, across.shape[0]), 1)
    label, variance = _frontmost(measured, limit**2, step)
    disparity = label[row, column]
    error = jnp.sqrt(variance[row, column])
    # In vignetted corners only the sensor's fixed pattern agrees between the views. It is
    # brightened with them.
    light = highest(100 * srgb_to_gray(view), 2)[row, column]
    lit = light > params.darkest * scene.exposure.scale
    consistent = candidates.valid & (error < limit)
    valid = consistent & lit

    height = jnp.where(candidates.alone, center[:, row, column], 0)
    height = jnp.where(candidates.filtered, strength[:, row, column], height).max(0)
    normal = unit_gradient(srgb_to_gray(view))[row, column]

    points = EdgePoints(
        xy=subpixel(strength, center, candidates),
        disparity=disparity,
        confidence=height / (height + params.half_confidence),
        error=error,
        normal=normal,
        visible=(shown[:, row, column] > 1 / (1 + params.deviation)).T,
        valid=valid,
    )
    stats = EdgeStats(candidates.total, candidates.overflow, consistent.sum(), valid.sum())
    return Edges(points.masked(), stats)
