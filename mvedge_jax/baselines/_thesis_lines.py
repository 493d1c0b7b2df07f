"""Lines of the thesis: fitted to filter responses, refined, tested."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from mvedge_jax.epi import EpiLines, FilterBank, epi_edge_map, fit_lines, merge_scales
from mvedge_jax.image import convolved, gaussian_taps

from ._alignment import aligned_count, alignment, line_visibility, longest_run
from ._entropy import entropy_search
from ._thesis_params import ThesisParams, ThesisSizes
from ._vote import spatial_vote

# Views in a row that a line must be aligned with; the authors'.
_RUN = 4
# Where the blur before the filters is cut, px.
_BLUR_REACH = 2


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
    params: ThesisParams,
    sizes: ThesisSizes,
    *,
    key: PRNGKeyArray | None,
) -> ArmLines:
    """Lines of one arm, at the scales asked for, refined and tested.

    Args:
        lab: its views in CIELAB; the vertical arm's with x and y swapped.
        bank: its filters.
        params: see `ThesisParams`.
        sizes: see `ThesisSizes`.
        key: draws the proposals of the entropy search.

    Returns:
        The lines. Differentiable at the lines chosen.

    Source: Thesis 4.1.1-4.1.5; what it leaves open is taken from the authors' program.
    """
    views, count, width, _ = lab.shape
    radius = params.suppression * views
    taps = gaussian_taps(params.smoothing, _BLUR_REACH)
    lab = convolved(convolved(lab, taps, 1), taps, 2)

    def lines_of(epi: Array) -> tuple[EpiLines, Array]:
        confidence, slope = epi_edge_map(
            epi, bank, modulate=sizes.modulate, interpolate=sizes.interpolate
        )
        confidence = jnp.where(confidence > params.floor, confidence, 0)
        return fit_lines(confidence, slope, radius, capacity=sizes.lines)

    epis = jnp.moveaxis(lab, 1, 0)
    lines, left = lax.map(lines_of, epis)
    left = left.sum()
    if sizes.levels == 2:
        coarse, more = lax.map(lines_of, jnp.moveaxis(_halved(lab), 1, 0))
        coarse = jax.tree.map(lambda leaf: jnp.repeat(leaf, 2, axis=0)[:count], coarse)
        lines = jax.vmap(lambda a, b: merge_scales(a, b, radius, views=views))(lines, coarse)
        left = left + more.sum()

    def judge(arguments: tuple) -> tuple[EpiLines, Array, Array]:
        light, found, *draw = arguments
        if sizes.entropy:
            found = entropy_search(light, found, params.amplitude, params.decay, key=draw[0])
        cosine = alignment(light, found)
        keep = found.valid & (found.position > -0.5) & (found.position < width - 0.5)
        if sizes.alignment == "count":
            keep = keep & (4 * aligned_count(cosine) >= views)
        if sizes.alignment == "run":
            keep = keep & (longest_run(cosine) >= _RUN)
        return found, keep, line_visibility(cosine, found, width=width)

    draws = () if key is None else (jax.random.split(key, count),)
    lines, keep, visible = lax.map(judge, (epis[..., 0], lines, *draws))
    if sizes.vote:
        keep = keep & (_votes(lines, keep, width=width, views=views) >= params.vote)
    return ArmLines(lines, keep, visible, left)


def _votes(lines: EpiLines, keep: Array, *, width: int, views: int) -> Array:
    """The spatial vote of every line, taken on the pixels where lines cross the centre view."""
    count, dtype = keep.shape[0], lines.disparity.dtype
    column = jnp.clip(jnp.round(lines.position).astype(jnp.int32), 0, width - 1)
    row = jnp.arange(count, dtype=jnp.int32)[:, None]
    place = jnp.where(keep, row * width + column, count * width)

    def raster(values: Array) -> Array:
        image = jnp.zeros(count * width, values.dtype).at[place].set(values, mode="drop")
        return image.reshape(count, width)

    found = raster(lines.disparity), raster(lines.confidence), raster(keep)
    votes = spatial_vote(*found, jnp.asarray(1 / max(views - 1, 1), dtype))
    return jnp.take_along_axis(votes, column, 1)
