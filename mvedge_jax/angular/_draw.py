"""Drawing samples into a view: the nearest one in front, holes from behind, edges by colour."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._fence import fenced
from mvedge_jax.color import srgb_to_linear
from mvedge_jax.warping import holes

from ._samples import Samples, landed

# Differences of disparity beyond this, px, are steps between two surfaces.
STEP = 0.1
# Reach of the vote, px, and the width of its Gaussian.
_REACH, _WIDTH = 3, 1.8
# Colours further apart than this, sRGB, are those of two surfaces.
_COLOUR = 0.2
# A pixel beside a step is not sure of its own surface, and has this share of a vote.
_DOUBT = 0.1
# Surfaces whose colours differ by less, linear light, do not tell what is covered; nor do those
# with less weight nearby.
_FAINT, _LEAST = 0.05, 0.3
# Variance of colours within either surface against the contrast between them, and votes against the
# share that is covered. From demo, crossing and thin.
_SCATTER, _VOTES = 4.0, 0.5
# Every other pixel of a disc: as good as all of them, in a third of the time.
_OFFSETS = tuple(
    (dy, dx)
    for dy in range(-_REACH, _REACH + 1)
    for dx in range(-_REACH, _REACH + 1)
    if (dy + dx) % 2 == 0 and dy * dy + dx * dx <= _REACH**2 + 1
)


class Drawing(NamedTuple):
    """Which sample every pixel of a view shows.

    Attributes:
        sample: its index.
        hole: where none landed and the sample is a neighbour's.
        spread: what the surfaces around a hole differ by, px; 0 elsewhere.
    """

    sample: Int[Array, "y x"]
    hole: Bool[Array, "y x"]
    spread: Float[Array, "y x"]


def drawn(samples: Samples, step: Float[Array, "2"], shape: tuple[int, int]) -> Drawing:
    """Draws samples into a view; in a hole, the farthest of the surfaces around it goes on.

    Args:
        samples: at least one of them lands in the view, or sample 0 is shown.
        step: `(u_c - u, v_c - v)` of the view.
        shape: of the view, px.

    Returns:
        The drawing. A selection: no gradient passes.
    """
    disparity = lax.stop_gradient(samples.disparity)
    place, pixels = landed(samples, step, shape), shape[0] * shape[1]
    nearest = jnp.full(pixels + 1, -jnp.inf, disparity.dtype)
    nearest = nearest.at[place].max(disparity, mode="promise_in_bounds")
    wins = disparity == nearest[place]
    own = jnp.arange(disparity.size, dtype=jnp.int32)
    # Any of the winners does: they are equal.
    winner = jnp.zeros(pixels + 1, jnp.int32)
    winner = winner.at[jnp.where(wins, place, pixels)].set(own, mode="promise_in_bounds")
    winner, nearest = winner[:-1].reshape(shape), nearest[:-1].reshape(shape)
    hit = jnp.isfinite(nearest)
    around = holes(nearest, hit, tolerance=STEP)
    return Drawing(winner.ravel()[around.behind], ~hit & ~around.crack, around.spread)


def decided(
    drawing: Drawing,
    samples: Samples,
    view: Float[Array, "c y x"],
    noise: Float[Array, ""],
) -> Drawing:
    """Decides by colour which side of a depth step the pixels beside it are on.

    Samples are put into whole pixels, and a pixel shows two surfaces that meet in it. Two things
    tell which of them holds its middle. Light adds up: between the mean colours of either surface
    nearby, the pixel's own, in linear light, says which share of it the front covers (by sRGB
    values, bright surfaces would grow). And pixels within reach vote for their own surface, as much
    as their colour is that of the pixel. Pixels beside a step count little in either.

    Args:
        drawing: of the view.
        samples: that it shows.
        view: its picture, sRGB.
        noise: standard deviation of the picture's noise, sRGB.

    Returns:
        The drawing, in which pixels beside steps show the front or the back surface. A selection.
    """
    view = lax.stop_gradient(view)
    disparity = lax.stop_gradient(samples.disparity)[drawing.sample]
    (front, nearer), (back, farther) = (
        _extreme(disparity, drawing.sample, sign) for sign in (1, -1)
    )
    beside = front - back > STEP
    middle = 0.5 * (front + back)
    sure = jnp.where(beside, _DOUBT, 1).astype(disparity.dtype)
    scale = 1 / (_COLOUR**2 + 16 * noise**2)
    score = fenced(_score, disparity, sure, view, srgb_to_linear(view), middle, scale)
    other = jnp.where(score > 0, nearer, farther)
    change = beside & ((score > 0) != (disparity > middle))
    return drawing._replace(sample=jnp.where(change, other, drawing.sample))


def _extreme(disparity: Array, index: Array, sign: int) -> tuple[Array, Array]:
    """The largest (or smallest) disparity of 3x3 pixels, and its sample."""
    best, which = sign * disparity, index
    for axis in (0, 1):
        own, own_which = best, which
        margin = [(0, 0), (0, 0)]
        margin[axis] = (1, 1)
        values, names = (jnp.pad(a, margin, mode="edge") for a in (own, own_which))
        for offset in (0, 2):
            size = disparity.shape[axis]
            value, name = (
                lax.slice_in_dim(a, offset, offset + size, axis=axis) for a in (values, names)
            )
            better = value > best
            best, which = jnp.where(better, value, best), jnp.where(better, name, which)
    return sign * best, which


def _score(
    disparity: Array, sure: Array, view: Array, light: Array, middle: Array, scale: Array
) -> Array:
    """What speaks for the front surface, less what speaks for the back one."""
    height, width = disparity.shape
    margin = (_REACH, _REACH)
    images = [jnp.pad(a, (margin, margin), mode="edge") for a in (disparity, *view, *light)]
    images.append(jnp.pad(sure, (margin, margin)))
    channels = view.shape[0]
    votes = jnp.zeros_like(disparity)
    # Of either surface: weights, and these times linear light, and times its square.
    sides = [[jnp.zeros_like(disparity)] * (2 + channels) for _ in range(2)]
    for dy, dx in _OFFSETS:
        start = (_REACH + dy, _REACH + dx)
        stop = (start[0] + height, start[1] + width)
        value, *colours, known = (lax.slice(a, start, stop) for a in images)
        alike = 1 / (1 + scale * _distance(colours[:channels], view))
        alike = alike * alike
        weight = float(np.exp(-0.5 * (dx * dx + dy * dy) / _WIDTH**2)) * known
        near = value > middle
        votes = votes + jnp.where(near, weight, -weight) * (alike * alike)
        terms = [jnp.ones_like(weight), *colours[channels:], _distance(colours[channels:])]
        for side, here in zip(sides, (near, ~near), strict=True):
            share = jnp.where(here, weight, 0)
            side[:] = [total + share * term for total, term in zip(side, terms, strict=True)]
    ahead, behind = sides[0][0], sides[1][0]
    tiny = jnp.finfo(disparity.dtype).tiny
    (bright, dark), scatter = ([], []), jnp.zeros_like(disparity)
    for mean, (total, *sums, squares) in zip((bright, dark), sides, strict=True):
        mean.extend(colour / jnp.maximum(total, tiny) for colour in sums)
        scatter = scatter + jnp.maximum(squares / jnp.maximum(total, tiny) - _distance(mean), 0)
    along = jnp.zeros_like(disparity)
    for own, first, second in zip(light, bright, dark, strict=True):
        along = along + (own - 0.5 * (first + second)) * (first - second)
    contrast = _distance(bright, dark)
    covered = jnp.clip(along / (contrast + _FAINT**2), -0.5, 0.5)
    told = (jnp.minimum(ahead, behind) > _LEAST) & (contrast > _FAINT**2)
    trust = contrast / (contrast + _SCATTER * scatter + tiny)
    votes = votes / jnp.maximum(ahead + behind, tiny)
    return jnp.where(told, covered * trust, 0) + _VOTES * votes


def _distance(colour: Sequence[Array], other: Sequence[Array] | Array | None = None) -> Array:
    """Squared distance of two colours, or of one from black."""
    total = jnp.zeros_like(colour[0])
    for index, own in enumerate(colour):
        total = total + (own if other is None else own - other[index]) ** 2
    return total
