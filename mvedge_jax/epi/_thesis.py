"""The point stage as the thesis has it: lines fitted to filter responses, tested and averaged."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from mvedge_jax._params import number

from ._alignment import aligned_count, alignment, line_visibility, longest_run
from ._bank import FilterBank
from ._entropy import entropy_search
from ._joint_filter import joint_filter
from ._lines import EpiLines, epi_edge_map, fit_lines, merge_scales
from ._vote import spatial_vote

_RUN = 4
_FEWEST_VIEWS = 3


class ThesisParams(eqx.Module):
    """Continuous parameters of the thesis' chain; the defaults are the thesis' and its authors'.

    Attributes:
        smoothing: standard deviation, px, of the blur before the filters.
        suppression: radius, as a share of the number of views, in which a line removes others.
        vote: least spatial vote of a line (Eq. 4.2).
        amplitude: first step of the entropy search, px.
        decay: factor per step.
        space_sigma: reach of the joint filter in space, px.
        disparity_sigma: in disparity, px per view step.
        colour_sigma: in colour, sRGB in [0, 1].
    """

    smoothing: Float[Array, ""] = number(0.85)
    suppression: Float[Array, ""] = number(0.2)
    vote: Float[Array, ""] = number(8e-5)
    amplitude: Float[Array, ""] = number(0.15)
    decay: Float[Array, ""] = number(0.88)
    space_sigma: Float[Array, ""] = number(5.0)
    disparity_sigma: Float[Array, ""] = number(0.1)
    colour_sigma: Float[Array, ""] = number(0.5)


@dataclass(frozen=True)
class ThesisSteps:
    """Which steps of the thesis' chain to run; all of them by default, but for the modulation.

    Attributes:
        lines: slots for lines per EPI.
        modulate: multiply responses by the local standard deviation (Alg. 1).
        levels: scales of the spatial pyramid (4.1.4), 1 or 2.
        alignment: keep lines aligned with the gradient in a quarter of the views ("count",
            Eq. 4.3) or in four in a row ("run", the authors'), or all ("none").
        vote: keep lines with a spatial vote (4.1.3).
        entropy: search for lines of lower entropy (Eq. 4.5).
        joint: average with neighbours in space, disparity and colour (Eq. 4.6).
    """

    lines: int = 256
    modulate: bool = False
    levels: int = 2
    alignment: Literal["none", "count", "run"] = "run"
    vote: bool = True
    entropy: bool = True
    joint: bool = True

    def __post_init__(self):
        if self.lines < 1:
            raise ValueError(f"`lines` must be positive, got {self.lines}.")
        if self.levels not in (1, 2):
            raise ValueError(f"`levels` must be 1 or 2, got {self.levels}.")
        if self.alignment not in ("none", "count", "run"):
            raise ValueError(
                f'`alignment` must be "none", "count" or "run", got {self.alignment!r}.'
            )


class ThesisPoints(NamedTuple):
    """What the chain finds; empty slots are not `valid`."""

    xy: Float[Array, "n 2"]
    disparity: Float[Array, " n"]
    strength: Float[Array, " n"]
    visible: Bool[Array, "n s"]
    valid: Bool[Array, " n"]
    lines: Int[Array, ""]
    overflow: Int[Array, ""]
    kept: Int[Array, ""]


def _smooth(arm: Float[Array, "u y x c"], sigma: Array) -> Float[Array, "u y x c"]:
    offsets = jnp.arange(-2, 3, dtype=arm.dtype)
    taps = jnp.exp(-0.5 * (offsets / sigma) ** 2)
    taps = taps / taps.sum()
    for axis in (1, 2):
        margin = [(0, 0)] * 4
        margin[axis] = (2, 2)
        padded = jnp.pad(arm, margin, mode="edge")
        size = arm.shape[axis]
        parts = [taps[k] * lax.slice_in_dim(padded, k, k + size, axis=axis) for k in range(5)]
        arm = sum(parts[1:], parts[0])
    return arm


def _halved(arm: Float[Array, "u y x c"]) -> Float[Array, "u y2 x2 c"]:
    """Means of 2x2 pixels; an odd border is repeated."""
    views, height, width, channels = arm.shape
    margin = ((0, 0), (0, height % 2), (0, width % 2), (0, 0))
    even = jnp.pad(arm, margin, mode="edge")
    return even.reshape(views, (height + 1) // 2, 2, (width + 1) // 2, 2, channels).mean((2, 4))


class _ArmLines(NamedTuple):
    lines: EpiLines
    keep: Array
    visible: Array
    left: Array


def _arm_lines(
    lab: Float[Array, "u e x c"],
    bank: FilterBank,
    steps: ThesisSteps,
    params: ThesisParams,
    floor: Array,
    key: PRNGKeyArray | None,
) -> _ArmLines:
    """Lines of all EPIs of one arm, at the scales asked for, refined and tested."""
    views, count, width, _ = lab.shape
    radius = params.suppression * views

    def lines_of(epi: Array) -> tuple[EpiLines, Array]:
        confidence, slope = epi_edge_map(epi, bank, modulate=steps.modulate)
        confidence = jnp.where(confidence > floor, confidence, 0)
        return fit_lines(confidence, slope, radius, capacity=steps.lines)

    epis = jnp.moveaxis(lab, 1, 0)
    lines, left = lax.map(lines_of, epis)
    if steps.levels == 2:
        coarse, more = lax.map(lines_of, jnp.moveaxis(_halved(lab), 1, 0))
        coarse = jax.tree.map(lambda leaf: jnp.repeat(leaf, 2, axis=0)[:count], coarse)
        lines = jax.vmap(lambda a, b: merge_scales(a, b, radius, views=views))(lines, coarse)
        left = left.sum() + more.sum()

    def judge(arguments: tuple) -> tuple[EpiLines, Array, Array]:
        light, found, *draw = arguments
        if steps.entropy:
            found = entropy_search(light, found, params.amplitude, params.decay, key=draw[0])
        cosine = alignment(light, found)
        keep = found.valid & (found.position > -0.5) & (found.position < width - 0.5)
        if steps.alignment == "count":
            keep = keep & (4 * aligned_count(cosine) >= views)
        if steps.alignment == "run":
            keep = keep & (longest_run(cosine) >= _RUN)
        return found, keep, line_visibility(cosine, found, width=width)

    draws = () if key is None else (jax.random.split(key, count),)
    lines, keep, visible = lax.map(judge, (epis[..., 0], lines, *draws))
    if steps.vote:
        column = jnp.clip(jnp.round(lines.position).astype(jnp.int32), 0, width - 1)
        place = jnp.where(keep, jnp.arange(count, dtype=jnp.int32)[:, None] * width + column, -1)
        place = jnp.where(place < 0, count * width, place)

        def raster(values: Array) -> Array:
            image = jnp.zeros(count * width, values.dtype).at[place].set(values, mode="drop")
            return image.reshape(count, width)

        votes = spatial_vote(
            raster(lines.disparity),
            raster(lines.confidence),
            raster(keep),
            jnp.asarray(1 / max(views - 1, 1), lab.dtype),
        )
        keep = keep & (jnp.take_along_axis(votes, column, 1) >= params.vote)
    return _ArmLines(lines, keep, visible, left.sum())


def thesis_points(
    lab: tuple[Float[Array, "u y x c"], Float[Array, "v x y c"]],
    colour: Float[Array, "y x c"],
    banks: tuple[FilterBank, FilterBank],
    params: ThesisParams,
    floor: Float[Array, ""],
    steps: ThesisSteps,
    *,
    capacity: int,
    key: PRNGKeyArray | None,
) -> ThesisPoints:
    """Runs the chain of Thesis 4.1 on both arms.

    Args:
        lab: views of the arms, the vertical one with x and y swapped.
        colour: the centre view, sRGB, for the joint filter.
        banks: filters of the arms.
        params: continuous parameters.
        floor: weakest response that may become a line, Lab units per px.
        steps: which steps to run.
        capacity: slots for points.
        key: draws the proposals of the entropy search; only that needs one.

    Returns:
        The points of both arms, one after the other.

    Raises:
        ValueError: if the entropy search is asked for without a key.

    Source: Thesis 4.1.1-4.1.5; what it leaves open is taken from the authors' program.
    """
    if steps.entropy and key is None:
        raise ValueError("`key` must be given for the entropy search, got None.")
    keys = (None, None) if key is None else tuple(jax.random.split(key))
    arms = [
        _arm_lines(_smooth(part, params.smoothing), bank, steps, params, floor, draw)
        for part, bank, draw in zip(lab, banks, keys, strict=True)
    ]
    height, width = colour.shape[:2]
    parts = []
    for index, arm in enumerate(arms):
        epi = jnp.arange(arm.keep.shape[0], dtype=lab[0].dtype)[:, None]
        epi = jnp.broadcast_to(epi, arm.keep.shape)
        along = arm.lines.position
        xy = jnp.stack([along, epi] if index == 0 else [epi, along], -1)
        # The authors hide a point from the other arm where the centre view does not show it.
        views = arm.visible.shape[-1]
        shown = arm.visible[..., views // 2, None]
        others = jnp.broadcast_to(shown, (*arm.keep.shape, lab[1 - index].shape[0]))
        order = [others, arm.visible] if index == 0 else [arm.visible, others]
        visible = jnp.concatenate(order, -1)
        keep = arm.keep & (visible.sum(-1) >= _FEWEST_VIEWS)
        fields = (xy, arm.lines.disparity, arm.lines.confidence, visible, keep)
        parts.append([field.reshape(-1, *field.shape[2:]) for field in fields])
    xy, disparity, strength, visible, keep = (
        jnp.concatenate(pair) for pair in zip(*parts, strict=True)
    )
    chosen = jnp.nonzero(keep, size=capacity, fill_value=0)[0]
    total = keep.sum()
    valid = jnp.arange(capacity, dtype=total.dtype) < total
    xy, disparity, strength, visible = (
        field[chosen] for field in (xy, disparity, strength, visible)
    )
    if steps.joint:
        column = jnp.clip(jnp.round(xy[:, 0]).astype(jnp.int32), 0, width - 1)
        row = jnp.clip(jnp.round(xy[:, 1]).astype(jnp.int32), 0, height - 1)
        place = jnp.where(valid, row * width + column, height * width)
        nothing = jnp.zeros(height * width, disparity.dtype)
        labels = nothing.at[place].set(disparity, mode="drop")
        present = nothing.at[place].set(1, mode="drop") > 0
        smooth = joint_filter(
            labels.reshape(height, width),
            present.reshape(height, width),
            colour,
            params.space_sigma,
            params.disparity_sigma,
            params.colour_sigma,
        )
        disparity = jnp.where(valid, smooth[row, column], disparity)
    lines = sum(arm.lines.valid.sum() for arm in arms)
    return ThesisPoints(
        xy,
        disparity,
        strength,
        visible,
        valid,
        jnp.asarray(lines),
        jnp.asarray(sum(arm.left for arm in arms)) + jnp.maximum(total - capacity, 0),
        jnp.asarray(sum(arm.keep.sum() for arm in arms)),
    )
