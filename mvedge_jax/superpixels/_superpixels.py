"""Superpixels of a light field: one label per surface patch in every view (Thesis Ch. 5)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._checks import checked_jit
from mvedge_jax._params import cast
from mvedge_jax._positions import check_regular
from mvedge_jax.all_views import ViewDepths
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.lightfield import LightField

from ._clustering import SuperpixelClustering, validate
from ._clusters import Surface, clustered, grid_over, surface_of
from ._pieces import Pieces, fewer, joined, numbered
from ._tables import tables_of
from ._views import canvas_of, continued, labeled

# Relative excess of pieces over the target; the smallest then join others.
_MORE = 0.03
# Rounds of an attempt that only estimates the number; relative distance from the target at which a
# full attempt follows; accepted relative excess.
_SHORT, _NEAR, _ENOUGH = 3, 0.04, 0.08
# Log limits of the factor of the cell size; and the largest area, as a share of the target area,
# of pieces that join others to meet the number.
_SMALLER, _LARGER, _SHARE = 1.0, 0.4, 0.75


class Superpixels(NamedTuple):
    """Superpixels; row k of a table is that of label k + 1.

    Attributes:
        labels: label of every pixel of every view, `[v, u, y, x]`, from 1 on; 0 for none.
        valid: rows of the tables in use.
        xy: mean position in the center view, px, also of labels that it does not show.
        plane: disparity at `xy`, px per view step, and its change per px along x and y.
        color: mean color, sRGB.
        area: number of pixels in the center view.
        parents: the least label among those connected without a depth step.
        neighbors: pairs of labels that touch in the center view, the smaller one first; 0 where
            unused.
        linked: pairs that touch without a depth step.
        number: number of superpixels; those beyond the capacity have no label.
    """

    labels: Int[Array, "v u y x"]
    valid: Bool[Array, " k"]
    xy: Float[Array, "k 2"]
    plane: Float[Array, "k 3"]
    color: Float[Array, "k 3"]
    area: Int[Array, " k"]
    parents: Int[Array, " k"]
    neighbors: Int[Array, "m 2"]
    linked: Bool[Array, " m"]
    number: Int[Array, ""]


@checked_jit(validate)
def superpixels(
    light_field: LightField, depths: ViewDepths, model: SuperpixelClustering
) -> Superpixels:
    """Cuts a light field into small patches of surface, each with one label in every view.

    1. The pixels of the center view are clustered by position, color and a slanted plane per
       cluster, with short contours; the cell size is adapted until the number of superpixels is
       right.
    2. Clusters are split into connected pieces and at every depth step. Small pieces join the most
       similar neighbor on their own surface; thin surfaces keep their own label.
    3. Surfaces that only other views show continue the superpixels of the same surface around
       them, by disparity, or become new superpixels.
    4. Every pixel of every view gets the label of the surface that it shows, by its disparity:
       views agree by construction, and outlines are those of the center view. A superpixel whose
       middle is hidden in a view has two pieces there.

    Args:
        light_field: the views; ground truth is not read.
        depths: disparity of all views, from `depth_of_views`.
        model: see `SuperpixelClustering.for_depths`.

    Returns:
        Labels of all views, missing ones included, and tables. Deterministic. Not differentiable;
        `soft_superpixels` is.

    Raises:
        ValueError: if the depths are not those of the views' grid and size, or the views are not
            on a regular grid; outside `jit`, a parameter is negative or not finite, or a divisor 0.
        TypeError: an argument is of another kind, or their order is another.

    Source: Thesis Ch. 5, which clusters EPI segments instead: see `experiments/peers/lfsp.py`.

    Example:
        >>> flat = jnp.zeros((1, 3, 20, 20))
        >>> depths = ViewDepths(flat, flat, flat.astype(jnp.int8), jnp.asarray(0))
        >>> model = SuperpixelClustering.for_depths(depths).replace(size=10.0)
        >>> light_field = LightField(jnp.full((1, 3, 20, 20, 3), 0.5))
        >>> found = superpixels(light_field, depths, model)
        >>> int(found.number), found.labels[0, 0, 0, ::10].tolist()
        (4, [1, 2])
    """
    check_depths(light_field, depths)
    check_regular(light_field, "`superpixels`")
    model = cast(model, light_field.views.dtype)
    disparities = depths.disparity.astype(light_field.views.dtype)
    vc, uc = light_field.center
    surface = surface_of(srgb_to_lab(light_field.center_view), disparities[vc, uc], model.step)
    center, count = _counted(surface, model)
    canvas = canvas_of(disparities, center, model.step, margin=model.margin)
    canvas, count = continued(canvas, count, model.step, model.speck, capacity=model.capacity)
    labels = labeled(
        disparities,
        center,
        canvas,
        model.step,
        model.fragment,
        margin=model.margin,
        capacity=model.capacity,
    )
    tables = tables_of(
        light_field, labels, surface, canvas, model, margin=model.margin, capacity=model.capacity
    )
    valid = jnp.arange(model.capacity, dtype=jnp.int32) < count
    return Superpixels(labels, valid, *tables, count)


def check_depths(light_field: LightField, depths: ViewDepths) -> None:
    """Raises a ValueError if depths are not those of a light field."""
    shape = light_field.views.shape[:4]
    if depths.disparity.shape != shape:
        raise ValueError(
            f"`depths` must have the shape of the views, {shape}, got {depths.disparity.shape}."
        )


class _Search(NamedTuple):
    """State of the search for the cell size (in logarithms) that meets the target number.

    Attributes:
        tried: number of attempts so far.
        size: cell size of the last attempt.
        following: cell size of the next attempt.
        slope: slope of the number over the cell size.
        off: number of the last attempt over the target.
        best: pieces of the full attempt nearest to the target.
        badness: distance of `best` from the target.
    """

    tried: Int[Array, ""]
    size: Float[Array, ""]
    following: Float[Array, ""]
    slope: Float[Array, ""]
    off: Float[Array, ""]
    best: Pieces
    badness: Float[Array, ""]


def _counted(surface: Surface, model: SuperpixelClustering) -> tuple[Array, Array]:
    """Labels of the center view, about as many as the target, and their number."""
    shape = surface.disparity.shape[0], surface.disparity.shape[1]
    pixels = jnp.asarray(shape[0] * shape[1], surface.disparity.dtype)
    wanted = pixels / model.size**2

    def attempt(state: _Search) -> _Search:
        # A few rounds estimate the number well enough for the search.
        full = (state.tried == model.attempts - 1) | (jnp.abs(state.off - _MORE) < _NEAR)
        rounds = jnp.where(full, model.rounds, min(_SHORT, model.rounds)).astype(jnp.int32)
        grid = grid_over(shape, jnp.exp(state.following), model.capacity)
        labels, _ = clustered(surface, grid, model, rounds, capacity=model.capacity)
        pieces = joined(surface, labels, model.size, model)
        off = jnp.log(numbered(pieces.root, model.capacity)[1].astype(wanted.dtype) / wanted)
        # An excess is reduced afterwards; a deficit stays.
        badness = jnp.where(full, jnp.where(off < 0, -4 * off, off), jnp.inf)
        better = badness < state.badness
        best = jax.tree.map(lambda new, old: jnp.where(better, new, old), pieces, state.best)
        # The number falls with the square of the size of cells; less, where pieces make it up.
        moved = state.following - state.size
        measured = (off - state.off) / jnp.where(moved == 0, 1, moved)
        known = (moved != 0) & jnp.isfinite(state.off)
        slope = jnp.where(known, jnp.clip(measured, -2.0, -0.7), state.slope)
        # A scene of many small surfaces has more superpixels than the target, instead of large
        # ones.
        following = state.following - (off - _MORE) / slope
        following = jnp.clip(following, size - _SMALLER, size + _LARGER)
        least = jnp.minimum(badness, state.badness)
        return _Search(state.tried + 1, state.following, following, slope, off, best, least)

    def going(state: _Search) -> Array:
        return (state.tried < model.attempts) & (state.badness > _ENOUGH)

    size, endless = jnp.log(model.size), jnp.full_like(wanted, jnp.inf)
    nothing = Pieces(jnp.zeros((shape[0] * shape[1], 5), wanted.dtype), jnp.zeros(shape, jnp.int32))
    first = jnp.asarray(0, jnp.int32)
    start = _Search(first, size, size, jnp.full_like(size, -1.5), endless, nothing, endless)
    best = lax.while_loop(going, attempt, start).best
    return numbered(fewer(best, surface, wanted, _SHARE * model.size**2).root, model.capacity)
