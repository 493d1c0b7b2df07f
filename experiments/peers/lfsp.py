"""The thesis' superpixels: EPI segments, clustered, painted, propagated (4.2.1, 5.1)."""

from dataclasses import dataclass
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from mvedge_jax._params import at_least, cast, number
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.edges.thesis import LineSearch
from mvedge_jax.image import convolved, gaussian_taps
from mvedge_jax.lightfield import LightField

from ._clustering import k_means, scaled, seed_grid, weighted
from ._lfsp_painting import Ends, mean_colors, width_of
from ._lfsp_segments import Segments, crosshair_segments
from ._lfsp_views import Field, painted_views, propagated

# What of the authors' program `LfspSizes.bugs` can bring back.
BUGS = ("steep", "strict", "scale", "median", "swapped", "clamped")
# Where the blur of colors is cut, px.
_BLUR_REACH = 2


def _lines() -> LineSearch:
    # The authors keep lines that no gradient is aligned with here: a quarter of them are wrong.
    return LineSearch(
        suppression=jnp.asarray(0.22), modulate=True, alignment="count", entropy=False
    )


class LfspParams(eqx.Module):
    """Weights of `thesis_superpixels`, each traced; the defaults are the authors'.

    Attributes:
        position: of a distance in the center view, per px.
        disparity: of all of the disparity range.
        color: of a difference of color, per unit of CIE Lab; the thesis has 3.
        lines: how lines are found; their smoothing is that of the segments' colors, too.
    """

    position: Float[Array, ""] = number(1.0, "per px")
    disparity: Float[Array, ""] = number(120.0, "per range")
    color: Float[Array, ""] = number(2.0, "per Lab")
    lines: LineSearch = eqx.field(default_factory=_lines)


@dataclass(frozen=True)
class LfspSizes:
    """Static sizes and steps of `thesis_superpixels`.

    Attributes:
        size: side of the cells of the grid of seeds, px.
        rounds: of k-means.
        bugs: what of the authors' program to bring back, to see what it changes: "steep", lines
            are drawn with 1/(views - 1) more slope; "strict", segments are colored by the pixels
            strictly between their lines; "scale", disparities are divided by the largest sum of
            themselves and the least magnitude; "median", fields are smoothed by the middle number
            of a label; "swapped", the propagation reads the disparity of the
            other arm's view; "clamped", what is pushed beyond the frame lands on its border.
    """

    size: int = 20
    rounds: int = 20
    bugs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        at_least(self, size=1, rounds=1)
        unknown = sorted(set(self.bugs) - set(BUGS))
        if unknown:
            raise ValueError(f"`bugs` must be of {', '.join(BUGS)}, got {', '.join(unknown)}.")


def thesis_superpixels(
    light_field: LightField, params: LfspParams, sizes: LfspSizes
) -> Int[Array, "v u y x"]:
    """Superpixels of all views by the thesis' own method: the peer of `superpixels`.

    1. Lines are found in the EPIs of the center row and column of views; those that no gradient is
       aligned with are dropped (4.3). They are matched into segments (`match_segments`); wide ones
       are split at the disparity of the vertical direction.
    2. Segments get the mean color of the pixels that show them, and the farther line's slope; a
       nearer border moves out as far as it ever is, so that a surface goes on beneath its occluder.
    3. k-means clusters the segments of both directions by place, disparity and color.
    4. Labels are painted into every view from both directions, far to near, and kept where the two
       agree or one is silent.
    5. From the center outwards along the crosshair, pixels without a label take that of the pixel
       near them that is closest in color and place, and hand it to all views that have none there,
       by that pixel's disparity (5.1). The matching cost among views in (5.1) has a weight of 1e-5
       in the authors' program and is left out.
    6. What is left takes the label of a pixel beside it.

    Args:
        light_field: all views; ground truth is not read.
        params: see `LfspParams`.
        sizes: see `LfspSizes`.

    Returns:
        Labels of all views, from 1 on; 0 where nothing is near. Labels may have many pieces.
        Matching and splitting run on the host: not to be called inside `jit`, not differentiable.

    Raises:
        ValueError: if the grid of views is not at least 3x3 with all views there, or a number of
            views is even.

    Source: Thesis 4.2.1, 5.1; what it leaves open is taken from the authors' program, whose faults
        are mended unless `sizes.bugs` brings them back.

    Example:
        >>> flat = LightField(jnp.full((3, 3, 20, 24, 3), 0.5))
        >>> labels = thesis_superpixels(flat, LfspParams(), LfspSizes(size=10))
        >>> labels[0, 2, 5, 3::12].tolist()
        [1, 2]
    """
    views = light_field.views
    grid, shape = views.shape[:2], (views.shape[2], views.shape[3])
    if min(grid) < 3 or grid[0] % 2 == 0 or grid[1] % 2 == 0:
        raise ValueError(
            f"`light_field` must have odd numbers of rows and columns of views, 3 or more, got "
            f"{grid[0]}x{grid[1]}."
        )
    if not bool(light_field.available.all()):
        missing = int((~light_field.available).sum())
        raise ValueError(f"`light_field` must have all of its views, {missing} are missing.")
    if "swapped" in sizes.bugs and grid[0] != grid[1]:
        raise ValueError(f"`bugs` may have swapped arms of equal lengths only, got {grid}.")
    params = cast(params, views.dtype)
    lab = jax.jit(srgb_to_lab)(views)
    vc, uc = light_field.center
    arms = lab[vc], jnp.swapaxes(lab[:, uc], 1, 2)
    smooth = [_smoothed(arm, params.lines.smoothing) for arm in arms]
    found = crosshair_segments(arms, smooth, params.lines)
    visible = [_colored(*pair, sizes) for pair in zip(found, smooth, strict=True)]
    names = _clustered(visible, params, sizes, shape=shape)
    fields, widths = [], []
    for (segments, _), label in zip(visible, names, strict=True):
        ends = _drawn(_parallel(segments), sizes)
        fields.append(Field(ends, jnp.asarray(segments.disparity), label))
        widths.append(width_of(ends, 0))
    labels, disparity = painted_views(
        (fields[0], fields[1]),
        light_field.steps,
        shape=shape,
        widths=(widths[0], widths[1]),
        median="median" in sizes.bugs,
    )
    swapped, clamped = "swapped" in sizes.bugs, "clamped" in sizes.bugs
    steps = light_field.steps
    return propagated(labels, disparity, lab, steps, swapped=swapped, clamped=clamped)


@jax.jit
def _smoothed(arm: Float[Array, "u e x 3"], sigma: Float[Array, ""]) -> Float[Array, "u e x 3"]:
    taps = gaussian_taps(sigma, _BLUR_REACH)
    return convolved(convolved(arm, taps, 1), taps, 2)


def _drawn(segments: Segments, sizes: LfspSizes) -> Ends:
    """Where segments are drawn."""
    left, right = segments.left, segments.right
    if "steep" in sizes.bugs:
        views = segments.views
        # A row is missing between the first end and the last one.
        turn = np.array([[1.0, 0.0], [-0.5, views / (views - 1)]], left.dtype)
        left, right = left @ turn, right @ turn
    return Ends.of(segments.epi, left, right)


def _colored(
    segments: Segments, smooth: Float[Array, "u e x 3"], sizes: LfspSizes
) -> tuple[Segments, np.ndarray]:
    """The segments that some view shows, and their mean colors."""
    ends = _drawn(segments, sizes)
    width = width_of(ends, segments.views // 2)
    color, seen = mean_colors(smooth, ends, width=width, strict="strict" in sizes.bugs)
    seen = np.asarray(seen)
    return segments.only(seen), np.asarray(color)[seen]


def _parallel(segments: Segments) -> Segments:
    """Moves the nearer border of each segment as far out as it comes, with the other's slope."""
    reach, farther = segments.views // 2, segments.disparity
    left, right = (
        np.stack([line[:, 0] + side * reach * (line[:, 1] - farther), farther], axis=1)
        for line, side in ((segments.left, -1), (segments.right, 1))
    )
    return segments._replace(left=left, right=right)


def _clustered(
    visible: list[tuple[Segments, np.ndarray]],
    params: LfspParams,
    sizes: LfspSizes,
    *,
    shape: tuple[int, int],
) -> list[Int[Array, " n"]]:
    """Labels of the segments of both directions, from 1 on."""
    places = []
    for (segments, _), turn in zip(visible, (1, -1), strict=True):
        middle = (segments.left[:, 0] + segments.right[:, 0]) / 2
        places.append(np.stack([middle, segments.epi], axis=1)[:, ::turn])
    lab = jnp.asarray(np.concatenate([color for _, color in visible]))
    place = jnp.asarray(np.concatenate(places), lab.dtype)
    disparity = jnp.asarray(np.concatenate([segments.disparity for segments, _ in visible]))
    found = _labels(place, disparity, lab, params, sizes, shape=shape)
    count = len(visible[0][1])
    return [found[:count], found[count:]]


@partial(jax.jit, static_argnames=("sizes", "shape"))
def _labels(
    place: Float[Array, "n 2"],
    disparity: Float[Array, " n"],
    lab: Float[Array, "n 3"],
    params: LfspParams,
    sizes: LfspSizes,
    *,
    shape: tuple[int, int],
) -> Int[Array, " n"]:
    depth = scaled(disparity)
    if "scale" in sizes.bugs:
        depth = disparity + jnp.abs(jnp.min(disparity))
        depth = depth / jnp.maximum(jnp.max(depth), 1e-6)
    weights = params.position, params.disparity, params.color
    features = weighted(place, depth, lab, weights)
    rows, columns = seed_grid(*shape, sizes.size)
    seeds = jnp.stack(jnp.meshgrid(columns, rows), axis=-1).reshape(-1, 2).astype(place.dtype)
    # A seed is the segment nearest to its place.
    near = lax.map(lambda seed: jnp.argmin(jnp.sum((place - seed[None]) ** 2, axis=1)), seeds)
    return 1 + k_means(features, features[near], rounds=sizes.rounds)
