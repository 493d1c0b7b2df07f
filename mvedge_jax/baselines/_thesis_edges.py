"""Edge points as the thesis finds them: lines of EPIs, tested and averaged."""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from mvedge_jax._compiler import lean_jit
from mvedge_jax._params import cast
from mvedge_jax.color import srgb_to_gray, srgb_to_lab
from mvedge_jax.edges import EdgePoints, Edges, EdgeStats
from mvedge_jax.image import nearest_pixels, unit_gradient
from mvedge_jax.lightfield import LightField

from ._joint_filter import joint_filter
from ._thesis_lines import ArmLines, arm_lines
from ._thesis_params import ThesisParams, ThesisSizes

# Views in which a point must be seen.
_FEWEST_VIEWS = 3
# Strength, CIELAB units per px, at which the confidence is one half.
_CONFIDENT = 2.0


@lean_jit
def thesis_edges(
    light_field: LightField,
    params: ThesisParams,
    sizes: ThesisSizes,
    *,
    key: PRNGKeyArray | None = None,
) -> Edges:
    """Finds edge points by the thesis' own chain: the baseline of `multiview_edges`.

    Filters answer in every EPI of both arms (4.1.1), lines are fitted to the answers, strongest
    first (4.1.2), at two scales (4.1.4), moved at random while their entropy falls, tested against
    the gradient of the EPI (4.1.5) and by a vote of their surroundings (4.1.3); what is left is
    averaged with neighbours of like place, disparity and colour. Views are compared as they are.

    Args:
        light_field: the crosshair of views is read; ground truth is not.
        params: see `ThesisParams`.
        sizes: see `ThesisSizes.for_light_field`.
        key: draws the proposals of the entropy search; only that needs one.

    Returns:
        The points of the horizontal arm, then those of the vertical one, and statistics:
        candidates are lines, consistent those that pass the tests. Nothing but the spacing of the
        filters is known of the error. Differentiable at the lines chosen; disparities in the taps
        only with `sizes.interpolate`.

    Raises:
        ValueError: if the entropy search is asked for without a key.

    Source: Thesis 4.1; what it leaves open is taken from the authors' program.

    Example:
        >>> flat = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
        >>> sizes = ThesisSizes.for_light_field(flat, lines=8)
        >>> int(thesis_edges(flat, ThesisParams(), sizes, key=jax.random.key(0)).stats.valid)
        0
    """
    if sizes.entropy and key is None:
        raise ValueError("`key` must be given for the entropy search, got None.")
    dtype = light_field.views.dtype
    params, centre = cast(params, dtype), light_field.centre_view
    keys = (None, None) if key is None else tuple(jax.random.split(key))
    down = jnp.swapaxes(light_field.vertical_arm, 1, 2)
    banks = params.banks
    if banks is None:
        banks = sizes.banks((down.shape[0], light_field.horizontal_arm.shape[0]), dtype)
    arms = [
        arm_lines(srgb_to_lab(arm), bank, params, sizes, key=draw)
        for arm, bank, draw in zip((light_field.horizontal_arm, down), banks, keys, strict=True)
    ]
    xy, disparity, strength, visible, keep = _of_both(arms[0], arms[1])

    chosen = jnp.nonzero(keep, size=sizes.capacity, fill_value=0)[0]
    total = keep.sum()
    valid = jnp.arange(sizes.capacity, dtype=total.dtype) < total
    xy, disparity, strength, visible = (a[chosen] for a in (xy, disparity, strength, visible))
    if sizes.joint:
        disparity = _smoothed(xy, disparity, valid, centre, params)
    row, column, _ = nearest_pixels(xy, (centre.shape[0], centre.shape[1]))
    points = EdgePoints(
        xy,
        disparity,
        confidence=strength / (strength + _CONFIDENT),
        error=jnp.full_like(disparity, 2 * sizes.reach / sizes.filters / math.sqrt(12)),
        normal=unit_gradient(srgb_to_gray(centre))[row, column],
        visible=visible,
        valid=valid,
    )

    def only(leaf: Array) -> Array:
        there = valid.reshape(-1, *[1] * (leaf.ndim - 1))
        return jnp.where(there, leaf, jnp.zeros_like(leaf))

    overflow = arms[0].left + arms[1].left + jnp.maximum(total - sizes.capacity, 0)
    lines = arms[0].lines.valid.sum() + arms[1].lines.valid.sum()
    return Edges(jax.tree.map(only, points), EdgeStats(lines, overflow, total, valid.sum()))


def _of_both(across: ArmLines, down: ArmLines) -> list[Array]:
    """Positions, disparities, strengths, visibilities of all lines, and which are points."""
    parts = []
    for own, other in ((across, down), (down, across)):
        epi = jnp.arange(own.keep.shape[0], dtype=own.lines.position.dtype)[:, None]
        epi, along = jnp.broadcast_to(epi, own.keep.shape), own.lines.position
        xy = jnp.stack([along, epi] if own is across else [epi, along], -1)
        # The authors hide a point from the other arm where the centre view does not show it.
        shown = own.visible[..., own.visible.shape[-1] // 2, None]
        others = jnp.broadcast_to(shown, (*own.keep.shape, other.visible.shape[-1]))
        order = [others, own.visible] if own is across else [own.visible, others]
        visible = jnp.concatenate(order, -1)
        keep = own.keep & (visible.sum(-1) >= _FEWEST_VIEWS)
        fields = (xy, own.lines.disparity, own.lines.confidence, visible, keep)
        parts.append([field.reshape(-1, *field.shape[2:]) for field in fields])
    return [jnp.concatenate(pair) for pair in zip(*parts, strict=True)]


def _smoothed(
    xy: Float[Array, "n 2"],
    disparity: Float[Array, " n"],
    valid: Bool[Array, " n"],
    colour: Float[Array, "y x c"],
    params: ThesisParams,
) -> Float[Array, " n"]:
    """Disparities after the joint filter."""
    height, width = colour.shape[:2]
    row, column, _ = nearest_pixels(xy, (height, width))
    place = jnp.where(valid, row * width + column, height * width)
    nothing = jnp.zeros(height * width, disparity.dtype)
    labels = nothing.at[place].set(disparity, mode="drop").reshape(height, width)
    present = nothing.at[place].set(1, mode="drop").reshape(height, width) > 0
    sigmas = params.space_sigma, params.disparity_sigma, params.colour_sigma
    return jnp.where(valid, joint_filter(labels, present, colour, *sigmas)[row, column], disparity)
