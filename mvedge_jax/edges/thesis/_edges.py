"""Edge points as the thesis finds them: lines of EPIs, tested and averaged."""

import math
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float, PRNGKeyArray

from mvedge_jax._params import at_least, cast, number, one_of, positive
from mvedge_jax.color import srgb_to_gray, srgb_to_lab
from mvedge_jax.epi import FilterBank, bank_radius, exponential_disparities, prewitt_bank
from mvedge_jax.image import nearest_pixels, unit_gradient
from mvedge_jax.photometry import Evidence

from .._points import EdgePoints, Edges, EdgeStats
from ._joint_filter import joint_filter
from ._lines import ArmLines, LineSearch, arm_lines


class ThesisEdges(eqx.Module):
    """Edges by the thesis' own steps (4.1); open details follow the authors' program.

    Lines are fitted to the filter responses in every EPI of both arms, strongest first (4.1.1,
    4.1.2), at two scales (4.1.4). They move at random while their entropy falls, and are tested
    against the gradient of the EPI (4.1.5) and by a vote of their surroundings (4.1.3). The
    remaining points are averaged with neighbors of similar position, disparity and color. The
    stated error of a point is that of the filters' spacing. Defaults are the thesis'; differences
    of the authors' program are options.

    Attributes:
        reach: largest disparity of the filters in magnitude, px per view step.
        capacity: slots for points.
        filters: number of filters, see `epi.exponential_disparities`.
        joint: average with neighbors in space, disparity and color (Eq. 4.6).
        lines: search and tests of lines.
        banks: filters of the horizontal and of the vertical arm; None for oriented Prewitt filters.
            Give them (`prewitt`) to learn them; disparities have a derivative in their taps with
            `lines.interpolate`.
        half_confidence: strength at which the confidence is one half.
        space_sigma: standard deviation of the joint filter in space; the authors' is 5 px.
        disparity_sigma: standard deviation of the joint filter in disparity.
        color_sigma: standard deviation of the joint filter in color, in the units of `color`.
        color: color space of the joint filter: `"lab"`, L* in 0..100, or the authors' `"srgb"`.
        hidden: keep points that the center view does not show (Eq. 4.4), for other views.
        fewest_views: least number of views that must show a point.
    """

    reach: float = eqx.field(static=True)
    capacity: int = eqx.field(static=True)
    filters: int = eqx.field(static=True, default=60)
    joint: bool = eqx.field(static=True, default=True)
    lines: LineSearch = eqx.field(default_factory=LineSearch)
    banks: tuple[FilterBank, FilterBank] | None = None
    half_confidence: Float[Array, ""] = number(2.0, "CIELAB/px")
    space_sigma: Float[Array, ""] = number(10.0, "px")
    disparity_sigma: Float[Array, ""] = number(0.1, "px")
    color_sigma: Float[Array, ""] = number(0.5, "of `color`")
    color: Literal["lab", "srgb"] = eqx.field(static=True, default="lab")
    hidden: bool = eqx.field(static=True, default=False)
    fewest_views: int = eqx.field(static=True, default=3)

    def __check_init__(self) -> None:
        positive(self, "reach")
        at_least(self, filters=4, capacity=1, fewest_views=1)
        one_of(self, color=("lab", "srgb"))

    def prewitt(
        self, views: tuple[int, ...], dtype: DTypeLike = jnp.float32
    ) -> tuple[FilterBank, FilterBank]:
        """Oriented Prewitt filters, denser around disparity 0: the start for learning filters.

        Args:
            views: a shape that begins with the rows and columns of the grid of views.
            dtype: dtype of the filters.

        Returns:
            The bank of the horizontal arm and that of the vertical one.

        Example:
            >>> across, down = ThesisEdges(reach=1.0, capacity=64).prewitt((3, 9))
            >>> across.taps.shape[:2], down.taps.shape[:2]
            ((59, 9), (59, 3))
        """
        disparity = jnp.asarray(exponential_disparities(self.filters, self.reach), dtype)
        across, down = (
            prewitt_bank(disparity, count, bank_radius(self.reach, count)) for count in views[1::-1]
        )
        return across, down

    def __call__(self, evidence: Evidence, *, key: PRNGKeyArray | None = None) -> Edges:
        """See `EdgeDetector`.

        Args:
            evidence: only the calibrated views are read.
            key: random key of the entropy search.

        Returns:
            The points of the horizontal arm, then those of the vertical one, and statistics:
            candidates are lines, consistent those that pass the tests. Differentiable at the lines
            chosen; disparities in the taps only with `lines.interpolate`.

        Raises:
            ValueError: the entropy search has no key.
        """
        if self.lines.entropy and key is None:
            raise ValueError(
                "`key` must be given for the entropy search of `ThesisEdges`, such as "
                "`jax.random.key(0)`, got None."
            )
        return _thesis_edges(evidence, self, key)


def _thesis_edges(evidence: Evidence, part: ThesisEdges, key: PRNGKeyArray | None) -> Edges:
    views = evidence.calibrated
    own, down = (jnp.moveaxis(arm.planes, 1, -1) for arm in views.arms)
    center = own[own.shape[0] // 2]
    part = cast(part, center.dtype)
    keys = (None, None) if key is None else tuple(jax.random.split(key))
    banks = part.banks
    if banks is None:
        banks = part.prewitt((down.shape[0], own.shape[0]), center.dtype)
    arms = [
        arm_lines(srgb_to_lab(arm), bank, part.lines, key=draw)
        for arm, bank, draw in zip((own, down), banks, keys, strict=True)
    ]
    xy, disparity, strength, visible, keep = _lines_of_both_arms(arms[0], arms[1], part)

    chosen = jnp.nonzero(keep, size=part.capacity, fill_value=0)[0]
    total = keep.sum()
    valid = jnp.arange(part.capacity, dtype=total.dtype) < total
    xy, disparity, strength, visible = (a[chosen] for a in (xy, disparity, strength, visible))
    if part.joint:
        color = srgb_to_lab(center) if part.color == "lab" else center
        sigmas = part.space_sigma, part.disparity_sigma, part.color_sigma
        disparity = joint_filter(xy, disparity, valid, color, *sigmas)
    row, column, _ = nearest_pixels(xy, evidence.shape)
    points = EdgePoints(
        xy,
        disparity,
        confidence=strength / (strength + part.half_confidence),
        error=jnp.full_like(disparity, 2 * part.reach / part.filters / math.sqrt(12)),
        normal=unit_gradient(srgb_to_gray(center))[row, column],
        visible=visible,
        valid=valid,
    )

    overflow = arms[0].left + arms[1].left + jnp.maximum(total - part.capacity, 0)
    lines = arms[0].lines.valid.sum() + arms[1].lines.valid.sum()
    return Edges(points.masked(), EdgeStats(lines, overflow, total, valid.sum()))


def _lines_of_both_arms(across: ArmLines, down: ArmLines, part: ThesisEdges) -> list[Array]:
    """Positions, disparities, strengths, visibilities of all lines, and which are points."""
    parts = []
    for own, other in ((across, down), (down, across)):
        epi = jnp.arange(own.keep.shape[0], dtype=own.lines.position.dtype)[:, None]
        epi, along = jnp.broadcast_to(epi, own.keep.shape), own.lines.position
        xy = jnp.stack([along, epi] if own is across else [epi, along], -1)
        # The authors hide a point from the other arm where the center view does not show it.
        shown = own.visible[..., own.visible.shape[-1] // 2, None]
        others = jnp.broadcast_to(shown, (*own.keep.shape, other.visible.shape[-1]))
        order = [others, own.visible] if own is across else [own.visible, others]
        visible = jnp.concatenate(order, -1)
        keep = own.keep & (visible.sum(-1) >= part.fewest_views)
        if not part.hidden:
            keep = keep & shown[..., 0]
        fields = (xy, own.lines.disparity, own.lines.confidence, visible, keep)
        parts.append([field.reshape(-1, *field.shape[2:]) for field in fields])
    return [jnp.concatenate(pair) for pair in zip(*parts, strict=True)]
