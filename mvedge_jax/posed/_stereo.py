"""Dense depth of a photograph from others around it: the light field's measurement, posed."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._compiler import lean_jit
from mvedge_jax._cpu import checkpoint_stage, plane_sum
from mvedge_jax._params import cast, readable
from mvedge_jax._root import LEAST_DIVISOR
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.depth import map_problems
from mvedge_jax.depth.solves import Given, Labels, Parts, precision_weight, refine_disparity
from mvedge_jax.image import box_mean, highest
from mvedge_jax.photometry import CalibratedViews, Noise, prepare, prepare_views
from mvedge_jax.photometry.brightness import PosedViews
from mvedge_jax.photometry.matching import best_match
from mvedge_jax.photometry.views import ViewSet

from ._model import StereoDepth
from ._photographs import Photographs
from ._problems import depth_problems
from ._reference import Reference

# Least disparity that is converted to depth, as a share of the range's upper end.
_FARTHEST = 1e-6


class StereoStats(NamedTuple):
    """Statistics of `stereo`.

    Attributes:
        iterations: solver iterations of every diffusion of the map.
        converged: whether every diffusion reached its tolerance.
        noise: noise of the photographs, in their units after brightening.
        gain: brightness of each photograph relative to the reference, which was removed; in the
            order of `Photographs`.
        searched: lowest and highest disparity searched, px per baseline.
        labeled: share of the pixels with an accepted label, see `Refine.accepted`, in the last
            solve. The other pixels are diffused from these and from the hypotheses.
    """

    iterations: Int[Array, " solves"]
    converged: Bool[Array, ""]
    noise: Noise
    gain: Float[Array, " n"]
    searched: Float[Array, "2"]
    labeled: Float[Array, ""]

    def __repr__(self) -> str:
        return readable(self)


class StereoResult(NamedTuple):
    """Depth of a photograph.

    Attributes:
        depth: distance along the optical axis, in the unit of the poses, `[y, x]`; NaN where the
            photograph is transparent.
        error: its standard error, in the same unit; infinite where there is no label at all.
        disparity: px per baseline, larger is nearer, `[y, x]`; see `Reference`; NaN as depth is.
        disparity_error: its standard error, px.
        first: initial disparities of the measurement.
        stats: counts.
        mask: pixels that are not transparent; None for all.
    """

    depth: Float[Array, "y x"]
    error: Float[Array, "y x"]
    disparity: Float[Array, "y x"]
    disparity_error: Float[Array, "y x"]
    first: Float[Array, "y x"]
    stats: StereoStats
    mask: Bool[Array, "y x"] | None = None

    def problems(self) -> tuple[str, ...]:
        """Problems of the depth by its statistics, one sentence each; on the host."""
        stats, asked = self.stats, slice(None) if self.mask is None else np.asarray(self.mask)
        maps = (self.disparity, self.disparity_error, self.depth, self.error)
        disparity, disparity_error, depth, error = (np.asarray(one)[asked] for one in maps)
        found = map_problems(disparity, disparity_error, stats.converged, stats.searched)
        return (*found, *depth_problems(depth, error, stats.labeled))


def stereo(photographs: Photographs, reference: Reference, model: StereoDepth) -> StereoResult:
    """Estimates the depth of every pixel of one of a few posed photographs.

    As `EdgeDepth` without edge points, with a homography and an epipole in place of a shift:

    1. Gains and vignettes of the photographs are measured and removed; noise is measured.
    2. Hypotheses: per pixel, the disparity at which the photographs that show it agree best, by
       color and by correlation, along paths through the image.
    3. Every pixel is measured in the photographs that show it, repeatedly, and the labels are
       diffused, together with weak ones by the hypotheses, with smoothness that is cut where a
       color step and a depth step coincide.
    4. A weighted median moves blurred depth steps onto color steps.

    The sparse points only give the range of depths, by `reference_of`.

    Args:
        photographs: two or more, without lens distortion; true depth is not read.
        reference: see `reference_of`. Its index is traced: one program for all photographs.
        model: see `StereoDepth.of`.

    Returns:
        Depth, disparity, standard errors, statistics. Differentiable, forwards and backwards, in
        images, poses, intrinsics, baseline and every leaf of `model` at the selections made.

    Source: Thesis 7.2.2 has the photographs; the measurement is ours.

    Example:
        >>> import jax
        >>> texture = jax.random.uniform(jax.random.key(0), (24, 40, 3))
        >>> images = jnp.stack([texture[:, 4:36], texture[:, 6:38]])
        >>> poses = jnp.stack([jnp.eye(4), jnp.eye(4).at[0, 3].set(0.1)])
        >>> matrix = jnp.asarray([[20.0, 0, 15.5], [0, 20.0, 11.5], [0, 0, 1]])
        >>> from mvedge_jax.posed import reference_of
        >>> pair = Photographs(images, poses, matrix)
        >>> wanted = reference_of(pair, 0, depth_range=(0.5, 4.0))
        >>> result = stereo(pair, wanted, StereoDepth.of(wanted))
        >>> round(float(jnp.median(result.depth)), 1)
        1.0
    """
    # Names are static, and the number of points is a shape: neither is read, but each would
    # compile another program.
    read = photographs.images, photographs.poses, photographs.intrinsics, photographs.mask
    return _stereo(read, reference, model)


@lean_jit
def _stereo(
    read: tuple[Array, Array, Array, Array | None],
    reference: Reference,
    model: StereoDepth,
) -> StereoResult:
    photographs = Photographs(*read[:3], mask=read[3])
    model, dtype = cast(model, photographs.images.dtype), photographs.images.dtype
    tried = _tried(reference, model, dtype)
    model = _adapted(model, reference, photographs, tried)
    scene = prepare(
        PosedViews(reference.views(photographs)),
        tried,
        model.matching,
        window=model.window,
        brightness=model.brightness,
    )
    prepared = checkpoint_stage(prepare_views)(scene, model.measurement)
    hypotheses, lit = scene.hypotheses, scene.lit
    assert hypotheses is not None
    first = hypotheses.disparity
    nothing = jnp.zeros_like(first)
    span = tried[-1] - tried[0]
    given = Given(
        Labels(_hypothesis_weight(scene, model), first),
        prepared,
        scene.lab,
        scene.guide,
        span,
        nothing,
        lit,
        hypotheses,
    )
    parts = Parts(model.dense, model.smoothness, model.solver, model.refine)
    found = refine_disparity(given, first, parts)
    gain = scene.exposure.gain
    stats = StereoStats(
        found.iterations,
        found.converged,
        scene.noise,
        jnp.zeros_like(gain).at[reference.order(photographs)].set(gain),
        jnp.stack([tried[0], tried[-1]]),
        found.labeled if lit is None else found.labeled / jnp.mean(lit.astype(found.error.dtype)),
    )
    around = hypotheses.variance_around(found.disparity)
    disparity_error = model.refine.error(found.error, found.disparity, around)
    maps = _in_depth(found.disparity, disparity_error, photographs, reference)
    mask = None if photographs.mask is None else photographs.mask[reference.index]
    return StereoResult(*maps, first, stats, mask)


def _hypothesis_weight(scene: CalibratedViews, model: StereoDepth) -> Float[Array, "y x"]:
    """Data weight of the first map, whose own variance and that of rival hypotheses add up."""
    hypotheses = scene.hypotheses
    assert hypotheses is not None
    rivals = model.refine.error.rivals(hypotheses.variance_around(hypotheses.disparity))
    alone = model.hypothesis * _textured(scene, model.window)
    views = scene.views
    if isinstance(views, ViewSet) and views.shown is not None:
        # Colors of transparent pixels say nothing about texture.
        alone = alone * (1 - highest(1 - views.shown[0], 2 * model.window))
    return alone * precision_weight(alone * rivals, model.refine.precision)


def _textured(scene: CalibratedViews, reach: int) -> Float[Array, "y x"]:
    """Share of texture, against noise, in the variance of every window of the reference."""
    mean, noise = box_mean(scene.guide, reach), scene.noise.deviation**2 * scene.guide.shape[0]
    variance = plane_sum(box_mean(scene.guide**2, reach) - mean**2)
    own = jnp.maximum(variance - noise, 0)
    return own / jnp.maximum(own + noise, LEAST_DIVISOR)


def _in_depth(
    disparity: Array, error: Array, photographs: Photographs, reference: Reference
) -> tuple[Array, Array, Array, Array]:
    """Depth, its standard error, disparity, its standard error; NaN where transparent."""
    scale = reference.scale(photographs)
    # Disparities are not below that of infinity.
    least = _FARTHEST * jnp.max(jnp.abs(reference.disparity_range))
    depth = scale / jnp.maximum(disparity, least.astype(disparity.dtype))
    maps = depth, error * depth**2 / scale, disparity, error
    if photographs.mask is None:
        return maps
    mask = photographs.mask[reference.index]
    depth, error, disparity, disparity_error = (
        jnp.where(mask, values, nothing)
        for values, nothing in zip(maps, 2 * (jnp.nan, jnp.inf), strict=True)
    )
    return depth, error, disparity, disparity_error


def _tried(reference: Reference, model: StereoDepth, dtype: DTypeLike) -> Float[Array, " d"]:
    """The disparities of the hypotheses."""
    low, high = reference.disparity_range.astype(dtype)
    return low + (high - low) * jnp.linspace(0, 1, model.hypotheses, dtype=dtype)


def _adapted(
    model: StereoDepth, reference: Reference, photographs: Photographs, tried: Array
) -> StereoDepth:
    """The model with the numbers that depend on the steps of disparity of steep surfaces."""
    # From pixel to pixel, a surface at 45 degrees changes its disparity by the disparity over the
    # focal length.
    focal = reference.scale(photographs) / reference.baseline.astype(tried.dtype)
    step = jnp.mean(tried) / focal
    same, precision = model.measurement.same_surface, model.refine.precision
    return model.replace(
        {
            "matching.slant": model.tilt * (tried[1] - tried[0]) / step,
            "measurement.same_surface": jnp.maximum(same, model.surface * step),
            "refine.precision": jnp.maximum(precision, model.coarse * step),
            "refine.error.rival": tried[1] - tried[0],
        }
    )


class PosedSweep(NamedTuple):
    """Depth by the cheapest hypothesis of every pixel.

    Attributes:
        depth: in the unit of the poses, `[y, x]`.
        disparity: px per baseline, `[y, x]`.
    """

    depth: Float[Array, "y x"]
    disparity: Float[Array, "y x"]


@lean_jit
def posed_sweep(photographs: Photographs, reference: Reference, model: StereoDepth) -> PosedSweep:
    """A plane sweep through posed photographs: a baseline without regularization.

    Args:
        photographs: two or more.
        reference: see `reference_of`.
        model: its `matching`, `hypotheses` and `window` are read.

    Returns:
        Depth and disparity. Differentiable at the hypotheses chosen, as `plane_sweep`.

    Source: not in the thesis; the plane sweep of Collins (1996) with a soft minimum over the views.
    """
    lab = jnp.moveaxis(srgb_to_lab(photographs.images[reference.index]), -1, 0)
    views, tried = reference.views(photographs), _tried(reference, model, lab.dtype)
    disparity, _ = best_match(views, lab, tried, model.matching, window=model.window)
    nothing = jnp.zeros_like(disparity)
    depth, _, disparity, _ = _in_depth(disparity, nothing, photographs, reference)
    return PosedSweep(depth, disparity)
