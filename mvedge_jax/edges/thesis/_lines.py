"""Lines of the thesis: fitted to filter responses, refined, tested."""

from typing import Literal, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from mvedge_jax._params import at_least, number, one_of
from mvedge_jax.epi import EpiLines, FilterBank, epi_edge_map, fit_lines, merge_scales
from mvedge_jax.image import convolved, gaussian_taps

from ._alignment import (
    FILTER_ANGLE,
    VISIBLE_ANGLE,
    Tested,
    aligned_count,
    alignment,
    line_visibility,
    longest_run,
)
from ._entropy import entropy_search
from ._vote import spatial_vote

Alignment = Literal["none", "count", "run"]


class LineSearch(eqx.Module):
    """How the thesis finds the lines of an EPI, and which of them it keeps.

    Attributes:
        floor: weakest response that may become a line.
        smoothing: standard deviation of the blur before the filters.
        suppression: radius in which a line removes others.
        vote_floor: least spatial vote of a line (Eq. 4.2).
        amplitude: α, first step of the entropy search.
        decay: t, factor per step.
        aligned: k of Eq. 4.3: least share of the views in which a line is aligned, with `"count"`.
        aligned_angle: τ_f, largest angle between a line and the gradient of the EPI (Eq. 4.3).
        visible_angle: τ_v, the same where a line is seen (Eq. 4.4).
        capacity: slots for lines per EPI.
        modulate: multiply responses by the local standard deviation (Alg. 1). The authors compute
            and do not use it: with the vote, it rejects two points of five.
        interpolate: disparities between those of the filters, see `epi.epi_edge_map`; the thesis
            has the filters'.
        levels: scales of the spatial pyramid (4.1.4), 1 or 2.
        alignment: keep lines aligned with the gradient in a share of the views (`"count"`,
            Eq. 4.3) or in `run` in a row (`"run"`, the authors'), or all (`"none"`).
        vote: keep lines with a spatial vote (4.1.3).
        entropy: search for lines of lower entropy (Eq. 4.5).
        run: views in a row that a line must be aligned with; the authors'.
        visibility: a line is seen in the views that it is aligned with (`"all"`, Eq. 4.4); or only
            the lines that a nearer one crosses are tested (`"crossed"`, the authors').
        blur_reach: where the blur before the filters is cut, px.
    """

    floor: Float[Array, ""] = number(0.1, "CIELAB/px", threshold=True)
    smoothing: Float[Array, ""] = number(0.85, "px")
    suppression: Float[Array, ""] = number(0.2, "views", threshold=True)
    vote_floor: Float[Array, ""] = number(8e-5, threshold=True)
    amplitude: Float[Array, ""] = number(0.15, "px")
    decay: Float[Array, ""] = number(0.88)
    aligned: Float[Array, ""] = number(0.25, "views", threshold=True)
    aligned_angle: Float[Array, ""] = number(FILTER_ANGLE, "rad", threshold=True)
    visible_angle: Float[Array, ""] = number(VISIBLE_ANGLE, "rad", threshold=True)
    capacity: int = eqx.field(static=True, default=256)
    modulate: bool = eqx.field(static=True, default=False)
    interpolate: bool = eqx.field(static=True, default=False)
    levels: int = eqx.field(static=True, default=2)
    alignment: Alignment = eqx.field(static=True, default="count")
    vote: bool = eqx.field(static=True, default=True)
    entropy: bool = eqx.field(static=True, default=True)
    run: int = eqx.field(static=True, default=4)
    visibility: Tested = eqx.field(static=True, default="all")
    blur_reach: int = eqx.field(static=True, default=2)

    def __check_init__(self) -> None:
        at_least(self, capacity=1, run=1, blur_reach=1)
        one_of(self, levels=(1, 2), alignment=get_args(Alignment), visibility=get_args(Tested))


def _halved(arm: Float[Array, "u y x c"]) -> Float[Array, "u y2 x2 c"]:
    """Means of 2x2 pixels; an odd border is repeated."""
    views, height, width, channels = arm.shape
    margin = ((0, 0), (0, height % 2), (0, width % 2), (0, 0))
    even = jnp.pad(arm, margin, mode="edge")
    return even.reshape(views, (height + 1) // 2, 2, (width + 1) // 2, 2, channels).mean((2, 4))


class ArmLines(NamedTuple):
    """Lines of all EPIs of one arm.

    Attributes:
        lines: of every EPI.
        keep: which of them pass the tests.
        visible: in which views of the arm.
        left: pixels of the edge maps left over when the slots for lines were full.
    """

    lines: EpiLines
    keep: Bool[Array, "e m"]
    visible: Bool[Array, "e m u"]
    left: Int[Array, ""]


def arm_lines(
    lab: Float[Array, "u e x c"],
    bank: FilterBank,
    params: LineSearch,
    *,
    key: PRNGKeyArray | None,
) -> ArmLines:
    """Lines of one arm, at the scales asked for, refined and tested.

    Args:
        lab: its views in CIELAB; the vertical arm's with x and y swapped.
        bank: its filters.
        params: see `LineSearch`.
        key: draws the proposals of the entropy search.

    Returns:
        The lines. Differentiable at the lines chosen.

    Source: Thesis 4.1.1-4.1.5; what it leaves open is taken from the authors' program.
    """
    views, count, width, _ = lab.shape
    radius = params.suppression * views
    taps = gaussian_taps(params.smoothing, params.blur_reach)
    lab = convolved(convolved(lab, taps, 1), taps, 2)

    def lines_of(epi: Array) -> tuple[EpiLines, Array]:
        confidence, slope = epi_edge_map(
            epi, bank, modulate=params.modulate, interpolate=params.interpolate
        )
        confidence = jnp.where(confidence > params.floor, confidence, 0)
        return fit_lines(confidence, slope, radius, capacity=params.capacity)

    epis = jnp.moveaxis(lab, 1, 0)
    lines, left = lax.map(lines_of, epis)
    left = left.sum()
    if params.levels == 2:
        coarse, more = lax.map(lines_of, jnp.moveaxis(_halved(lab), 1, 0))
        coarse = jax.tree.map(lambda leaf: jnp.repeat(leaf, 2, axis=0)[:count], coarse)
        lines = jax.vmap(lambda a, b: merge_scales(a, b, radius, views=views))(lines, coarse)
        left = left + more.sum()

    def judge(arguments: tuple) -> tuple[EpiLines, Array, Array]:
        light, lines, *draw = arguments
        if params.entropy:
            lines = entropy_search(light, lines, params.amplitude, params.decay, key=draw[0])
        cosine = alignment(light, lines)
        keep = lines.valid & (lines.position > -0.5) & (lines.position < width - 0.5)
        if params.alignment != "none":
            keep = keep & _aligned(cosine, params)
        seen = line_visibility(
            cosine, lines, width=width, tested=params.visibility, angle=params.visible_angle
        )
        return lines, keep, seen

    draws = () if key is None else (jax.random.split(key, count),)
    lines, keep, visible = lax.map(judge, (epis[..., 0], lines, *draws))
    if params.vote:
        keep = keep & (_votes(lines, keep, width=width, views=views) >= params.vote_floor)
    return ArmLines(lines, keep, visible, left)


def _aligned(cosine: Float[Array, "m u"], params: LineSearch) -> Bool[Array, " m"]:
    """The lines that pass Eq. 4.3, or the authors' test."""
    if params.alignment == "run":
        return longest_run(cosine, angle=params.aligned_angle) >= params.run
    count = aligned_count(cosine, angle=params.aligned_angle).astype(cosine.dtype)
    return count >= params.aligned * cosine.shape[1]


def _votes(lines: EpiLines, keep: Array, *, width: int, views: int) -> Array:
    """The spatial vote of every line, taken on the pixels where lines cross the center view."""
    count, dtype = keep.shape[0], lines.disparity.dtype
    column = jnp.clip(jnp.round(lines.position).astype(jnp.int32), 0, width - 1)
    row = jnp.arange(count, dtype=jnp.int32)[:, None]
    place = jnp.where(keep, row * width + column, count * width)

    def raster(values: Array) -> Array:
        image = jnp.zeros(count * width, values.dtype).at[place].set(values, mode="drop")
        return image.reshape(count, width)

    images = raster(lines.disparity), raster(lines.confidence), raster(keep)
    votes = spatial_vote(*images, jnp.asarray(1 / max(views - 1, 1), dtype))
    return jnp.take_along_axis(votes, column, 1)
