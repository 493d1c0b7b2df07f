"""What the views say about a map: a correction per pixel, and how far the views agree on it."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import cast, number
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.diffusion import Solver, System, diffuse
from mvedge_jax.losses import Views
from mvedge_jax.photometry import box_mean, spline_coefficients
from mvedge_jax.warping import visible

from ._smoothness import SmoothnessParams, edge_smoothness


class EvidenceParams(eqx.Module):
    """Parameters of the evidence.

    Attributes:
        noise: standard deviation of the images' noise, quantisation included, in units of sRGB.
        outlier: residuals this many times larger than those of the other views stop counting.
        same_surface: neighbours whose disparity differs by much more than this, px, do not take
            part in a pixel's measurement.
        depth_step: pixels beside which the map jumps by more than this, px, measure nothing: their
            colours are mixtures.
        drift: stiffness of the colour drift; 0 leaves it free, a large value forbids it.
        largest: standard deviation of corrections before anything is measured, px; also their
            limit.
        error: of the map's labels, px; evidence that is better than this does not count more.
        smoothness: of the correction, against the evidence.
        region: radius of the regions over which both halves of the views have to agree, px.
        edges: where the correction may jump.
    """

    noise: Float[Array, ""] = number(1.5 / 255)
    outlier: Float[Array, ""] = number(2.0)
    same_surface: Float[Array, ""] = number(0.1)
    depth_step: Float[Array, ""] = number(0.1)
    drift: Float[Array, ""] = number(1.0)
    largest: Float[Array, ""] = number(0.1)
    error: Float[Array, ""] = number(0.004)
    smoothness: Float[Array, ""] = number(1.0)
    region: Float[Array, ""] = number(3.0)
    edges: SmoothnessParams = eqx.field(default_factory=SmoothnessParams)


class Evidence(NamedTuple):
    """A measured correction of a map.

    Attributes:
        change: to add to the map, px per view step.
        variance: of the change, px².
    """

    change: Float[Array, "y x"]
    variance: Float[Array, "y x"]


class Correction(NamedTuple):
    """A correction that both halves of the views support.

    Attributes:
        change: to add to the map, px per view step, smooth within surfaces.
        weight: how well it is known, in [0, 1].
        share: how much of what one half of the views proposes the other half confirms, in [0, 1].
    """

    change: Float[Array, "y x"]
    weight: Float[Array, "y x"]
    share: Float[Array, "y x"]


class _Sums(NamedTuple):
    """Per pixel: moments of the view steps (s sᵀ), with gradients g and colours r of the views."""

    xx: Array
    xy: Array
    yy: Array
    gradient_x: Array  # (Σ s sᵀ) g, per channel
    gradient_y: Array
    colour_x: Array  # Σ s r, per channel
    colour_y: Array
    contrast: Array  # Σ_c gᵀ (Σ s sᵀ) g
    match: Array  # Σ_c gᵀ Σ s r
    residual: Array
    freedom: Array


@eqx.filter_jit
def view_evidence(
    views: Views,
    disparity: Float[Array, "y x"],
    params: EvidenceParams,
    *,
    window: int = 2,
    margin: int = 1,
) -> Evidence:
    r"""Measures by how much the views would move each pixel of a map.

    Around the map, the colour that view i shows of a pixel is
    :math:`r_i = c + s_i \cdot (g\,\varepsilon + h)`, with the view step s, the image gradient g
    (the mean over the views), the error ε of the disparity, and a drift h of the colour from view
    to view: gloss, and shading that slides over curved surfaces. Within a window on one surface ε
    and h (two numbers per channel) are the same while g is not, so that a least-squares fit of both
    tells parallax from drift. Without h, shading is taken for parallax: on the benchmark's
    *cotton* that bias, not noise, is most of the error that is left.

    Pixels beside depth steps measure nothing, nor do views at whose occlusion borders a pixel
    lies; views that disagree with the others count less.

    Args:
        views: all that there are; more views help in proportion to their squared steps.
        disparity: the map, px per view step, finite.
        params: see `EvidenceParams`.
        window: half the width of the windows, px.
        margin: how far depth steps and occlusion borders spoil measurements, px.

    Returns:
        Correction and variance. A pixel that measures nothing has the variance `largest²` and
        no correction.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> image = jax.random.uniform(jax.random.key(0), (3, 16, 16))
        >>> others = jnp.stack([jnp.roll(image, 1, 2), jnp.roll(image, -1, 2)])
        >>> steps = jnp.array([[1.0, 0.0], [-1.0, 0.0]])
        >>> views = Views(image, others, steps, jnp.ones(2, bool))
        >>> found = view_evidence(views, jnp.full((16, 16), 0.98), EvidenceParams())
        >>> bool(jnp.abs(found.change[4:-4, 4:-4] - 0.02).max() < 0.005)
        True
    """
    dtype = disparity.dtype
    params = cast(params, dtype)
    images = jnp.concatenate([views.centre[None], views.others])
    steps = jnp.concatenate([jnp.zeros((1, 2), dtype), views.steps.astype(dtype)])
    available = jnp.concatenate([jnp.ones(1, bool), views.available])
    sums = _per_pixel(images, steps, available, disparity, params, margin)
    measures = _away_from_steps(disparity, params.depth_step, margin).astype(dtype)
    sums = jax.tree.map(lambda part: _times(measures, part), sums)
    total = _gather(sums, disparity, params, window)

    xx, yy = total.xx + params.drift, total.yy + params.drift
    determinant = xx * yy - total.xy**2
    ixx, ixy, iyy = ((part / determinant)[None] for part in (yy, -total.xy, xx))

    def drift(x: Array, y: Array) -> tuple[Array, Array]:
        return ixx * x + ixy * y, ixy * x + iyy * y

    gx, gy = drift(total.gradient_x, total.gradient_y)
    hx, hy = drift(total.colour_x, total.colour_y)
    contrast = total.contrast - jnp.sum(gx * total.gradient_x + gy * total.gradient_y, axis=0)
    match = total.match - jnp.sum(gx * total.colour_x + gy * total.colour_y, axis=0)
    contrast = jnp.maximum(contrast, 0)
    residual = total.residual - jnp.sum(hx * total.colour_x + hy * total.colour_y, axis=0)
    residual = jnp.maximum(residual, 0) / jnp.maximum(total.freedom, 1)
    spread = jnp.maximum(residual, params.noise**2)
    information = contrast / spread + 1 / params.largest**2
    change = -match / spread / information
    return Evidence(params.largest * jnp.tanh(change / params.largest), 1 / information)


def _per_pixel(
    images: Float[Array, "k c y x"],
    steps: Float[Array, "k 2"],
    available: Bool[Array, "k"],
    disparity: Float[Array, "y x"],
    params: EvidenceParams,
    margin: int,
) -> _Sums:
    """Normal equations of every pixel, over the views that see it."""
    channels = images.shape[1]
    zero, zeros = jnp.zeros_like(disparity), jnp.zeros_like(images[0])

    def look(total: tuple[Array, ...], view: tuple[Array, Array, Array]):
        image, step, there = view
        seen = _shrink(visible(disparity, step), margin) | jnp.all(step == 0)
        weight = (seen & there).astype(disparity.dtype)
        value, gx, gy = _sample(image, disparity, step)
        w = weight[None]
        terms = (weight, w * value, w * value**2, w * gx, w * gy)
        return tuple(t + new for t, new in zip(total, terms, strict=True)), (weight, value)

    first = (zero, zeros, zeros, zeros, zeros)
    (count, colour, square, gx, gy), seen = lax.scan(look, first, (images, steps, available))
    mean, gx, gy = (part / count[None] for part in (colour, gx, gy))
    spread = jnp.sum(square / count[None] - mean**2, axis=0)
    scale = params.outlier * jnp.maximum(box_mean(spread, 1), channels * params.noise**2)

    def add(total: tuple[Array, ...], view: tuple[Array, Array, Array]):
        weight, value, step = view
        relative = value - mean
        weight = weight / (1 + box_mean(jnp.sum(relative**2, axis=0), 1) / scale)
        x, y = step
        w = weight[None]
        terms = (
            weight, weight * x, weight * y, weight * x * x, weight * x * y, weight * y * y,
            w * relative, w * x * relative, w * y * relative, w * relative**2,
        )  # fmt: skip
        return tuple(t + new for t, new in zip(total, terms, strict=True)), None

    first = (zero,) * 6 + (zeros,) * 4
    (n, x, y, xx, xy, yy, r, rx, ry, rr), _ = lax.scan(add, first, (*seen, steps))
    xx, xy, yy = xx - x * x / n, xy - x * y / n, yy - y * y / n
    rx, ry = rx - (x / n)[None] * r, ry - (y / n)[None] * r
    along_x, along_y = (a[None] * gx + b[None] * gy for a, b in ((xx, xy), (xy, yy)))
    return _Sums(
        xx, xy, yy, along_x, along_y, rx, ry,
        jnp.sum(gx * along_x + gy * along_y, axis=0),
        jnp.sum(gx * rx + gy * ry, axis=0),
        jnp.sum(rr - r * r / n[None], axis=0),
        channels * jnp.maximum(n - 1, 0),
    )  # fmt: skip


def _gather(own: _Sums, disparity: Array, params: EvidenceParams, window: int) -> _Sums:
    """Sums the normal equations over neighbours on the same surface."""
    size = 2 * window + 1
    around = ((window, window), (window, window))
    padded = jax.tree.map(lambda a: jnp.pad(a, ((0, 0),) * (a.ndim - 2) + around), own)
    near = jnp.pad(disparity, window, mode="edge")

    def part(whole: Array, offset: Array) -> Array:
        start = (0,) * (whole.ndim - 2) + (offset // size, offset % size)
        return lax.dynamic_slice(whole, start, (*whole.shape[:-2], *disparity.shape))

    def add(total: _Sums, offset: Array) -> tuple[_Sums, None]:
        same = jnp.exp(-(((part(near, offset) - disparity) / params.same_surface) ** 2))
        return jax.tree.map(lambda t, p: t + _times(same, part(p, offset)), total, padded), None

    return lax.scan(add, jax.tree.map(jnp.zeros_like, own), jnp.arange(size * size))[0]


@eqx.filter_jit
def agreed_correction(
    views: Views,
    disparity: Float[Array, "y x"],
    params: EvidenceParams,
    *,
    window: int = 2,
    margin: int = 1,
) -> Correction:
    r"""Corrects a map as far as views confirm that were not asked.

    The views are split like a chessboard. Each half proposes a correction u, diffused within
    surfaces; the share of it that is taken is the one that explains the other half's own
    measurement m best in a region around,
    :math:`\alpha = \sum w\,m\,u / \sum w\,u^2`, within [0, 1]. Noise is confirmed by nobody, and
    goes: no threshold has to be chosen. The result is the mean of both halves.

    Args:
        views: all that there are. A half without views proposes and confirms nothing.
        disparity: the map, px per view step, finite.
        params: see `EvidenceParams`.
        window: see `view_evidence`.
        margin: see `view_evidence`.

    Returns:
        The correction and how far it was confirmed.
    """
    params = cast(params, disparity.dtype)
    odd = jnp.mod(jnp.round(jnp.sum(views.steps, axis=1)), 2) == 1
    lab = jnp.moveaxis(srgb_to_lab(jnp.moveaxis(views.centre, 0, -1)), -1, 0)
    tx, ty = edge_smoothness(lab, disparity, params.edges)
    solver = Solver(tolerance=jnp.asarray(1e-4, disparity.dtype))

    def propose(half: Bool[Array, "k"]) -> tuple[Array, Array, Array]:
        part = Views(views.centre, views.others, views.steps, views.available & half)
        measured = view_evidence(part, disparity, params, window=window, margin=margin)
        # A pixel that measured nothing says nothing, not that there is no change.
        known = 1 / measured.variance - 1 / params.largest**2
        weight = known * params.error**2 / (1 + known * params.error**2)
        stiff = params.smoothness
        system = System(weight + 1e-6, measured.change, stiff * tx, stiff * ty)
        return diffuse(system, solver=solver).value, measured.change, weight

    proposed, measured, weight = lax.map(propose, jnp.stack([odd, ~odd]))
    other_measured, other_weight = measured[::-1], weight[::-1]
    confirmed = _blur(other_weight * other_measured * proposed, params.region)
    asked = _blur(other_weight * proposed**2, params.region)
    tiny = jnp.asarray(1e-14, disparity.dtype)
    share = jnp.clip(confirmed / (asked + tiny), 0, 1)
    change = jnp.mean(share * proposed, axis=0)
    return Correction(change, jnp.mean(weight, axis=0), jnp.mean(share, axis=0))


def _sample(
    image: Float[Array, "c y x"], disparity: Float[Array, "y x"], step: Float[Array, "2"]
) -> tuple[Array, Array, Array]:
    """Cubic spline of a view where it sees the pixels, and its derivatives along x and y."""
    channels, height, width = image.shape
    spline = spline_coefficients(spline_coefficients(image, axis=-1), axis=-2)
    x = jnp.arange(width, dtype=disparity.dtype)[None] + step[0] * disparity
    y = jnp.arange(height, dtype=disparity.dtype)[:, None] + step[1] * disparity
    x, y = jnp.clip(x, 0, width - 1), jnp.clip(y, 0, height - 1)
    column, row = jnp.floor(x), jnp.floor(y)
    (wx, dx), (wy, dy) = _cubic(x - column), _cubic(y - row)
    column, row = column.astype(jnp.int32), row.astype(jnp.int32)
    flat = spline.reshape(channels, -1)
    wx, wy, dx, dy = ([w[None] for w in weights] for weights in (wx, wy, dx, dy))
    value = slope_x = slope_y = jnp.zeros_like(image)
    for j in range(4):
        base = jnp.clip(row + (j - 1), 0, height - 1) * width
        line = line_x = jnp.zeros_like(image)
        for i in range(4):
            at = base + jnp.clip(column + (i - 1), 0, width - 1)
            taps = jnp.stack(
                [flat[c].at[at].get(mode="promise_in_bounds") for c in range(channels)]
            )
            line, line_x = line + wx[i] * taps, line_x + dx[i] * taps
        value, slope_x = value + wy[j] * line, slope_x + wy[j] * line_x
        slope_y = slope_y + dy[j] * line
    return value, slope_x, slope_y


def _times(weight: Float[Array, "y x"], planes: Array) -> Array:
    """Every plane of `planes` (`[y, x]` or `[c, y, x]`) times a weight per pixel."""
    return weight.reshape((1,) * (planes.ndim - 2) + weight.shape) * planes


def _cubic(f: Array) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Weights of the cubic B-spline and their derivatives."""
    g = 1 - f
    weights = (
        g * g * g / 6,
        (4 + f * f * (3 * f - 6)) / 6,
        (4 + g * g * (3 * g - 6)) / 6,
        f * f * f / 6,
    )
    return weights, (-0.5 * g * g, f * (1.5 * f - 2), g * (2 - 1.5 * g), 0.5 * f * f)


def _away_from_steps(disparity: Array, step: Array, margin: int) -> Bool[Array, "y x"]:
    """Where the map does not bend by `step` within `margin` pixels; slants are no steps."""
    p = jnp.pad(disparity, 1, mode="edge")
    across = jnp.abs(p[1:-1, 2:] - 2 * disparity + p[1:-1, :-2])
    down = jnp.abs(p[2:, 1:-1] - 2 * disparity + p[:-2, 1:-1])
    smooth = jnp.maximum(across, down) < step
    return _shrink(smooth, margin - 1)


def _shrink(mask: Bool[Array, "y x"], times: int) -> Bool[Array, "y x"]:
    """Takes the outermost pixels off; the image's border is none."""
    for _ in range(times):
        p = jnp.pad(mask, 1, constant_values=True)
        mask = mask & p[:-2, 1:-1] & p[2:, 1:-1] & p[1:-1, :-2] & p[1:-1, 2:]
    return mask


def _blur(planes: Float[Array, "k y x"], sigma: Float[Array, ""]) -> Float[Array, "k y x"]:
    """Gaussian of 25 taps per axis, nothing beyond the borders."""
    taps = jax.nn.softmax(-0.5 * (jnp.arange(-12, 13, dtype=planes.dtype) / sigma) ** 2)
    down = lax.conv_general_dilated(
        planes[:, None], taps[None, None, :, None], (1, 1), ((12, 12), (0, 0))
    )
    across = lax.conv_general_dilated(down, taps[None, None, None, :], (1, 1), ((0, 0), (12, 12)))
    return across[:, 0]
