"""Bidirectional diffusion: all labels move to one side of their edges, then to the other."""

from collections.abc import Callable
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import lineax as lx
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._params import accepts_numpy, cast, number, one_of
from mvedge_jax._root import safe_sqrt
from mvedge_jax.diffusion import AutoSolver, System, diffuse, edge_weights
from mvedge_jax.image import gradient_magnitude, gradient_square
from mvedge_jax.interpolation import exact_shift

from .._points import EdgePoints
from .._raster import rasterize
from ._profile import profiles, step_response


def _coarse() -> AutoSolver:
    """A coarse solver: its error is far below relevant depth steps, at a fraction of the cost."""
    return AutoSolver(tolerance=1e-3)


class DirectionalDiffusion(eqx.Module):
    r"""Parameters of the two directional solves.

    Attributes:
        offset: distance by which labels move along the normal, px.
        data: weight of a label relative to a smoothness of 1.
        gradient: image gradient that halves the smoothness, or its square, see `form`; gray levels
            in 0..1.
        floor: least smoothness.
        form: smoothness falls with the `"squared"` gradient $g$, $1 / (1 + |\nabla I|^2 / g)$, or
            is `"inverse"` to it, $g / (|\nabla I| + g)$, as Eq. 4.11 has it.
        solver: solver of both systems.
    """

    offset: Float[Array, ""] = number(1.0, "px", threshold=True)
    data: Float[Array, ""] = number(100.0, "smoothness of 1")
    gradient: Float[Array, ""] = number(1e-4, "gray/px, squared or not")
    floor: Float[Array, ""] = number(1e-4, threshold=True)
    form: Literal["squared", "inverse"] = eqx.field(static=True, default="squared")
    solver: lx.AbstractLinearSolver = eqx.field(default_factory=_coarse)

    def __check_init__(self) -> None:
        one_of(self, form=("squared", "inverse"))


class Bidirectional(NamedTuple):
    """The two passes, with responses and confidences.

    Attributes:
        forward: map with the labels pushed along `+normal`, px per view step, `[y, x]`.
        backward: along `-normal`.
        response: step response of the forward pass minus that of the backward pass, px, `[n]`;
            positive speaks for `+normal`.
        confidence: depth-edge confidence of every point, `lambda_e` of (6.3), px, `[n]`.
        edge: depth-edge confidence of every pixel (Section 4.3), px per px, `[y, x]`.
        iterations: solver iterations of both passes.
    """

    forward: Float[Array, "y x"]
    backward: Float[Array, "y x"]
    response: Float[Array, " n"]
    confidence: Float[Array, " n"]
    edge: Float[Array, "y x"]
    iterations: Array


@accepts_numpy
def bidirectional(
    points: EdgePoints,
    gray: Float[Array, "y x"],
    params: DirectionalDiffusion,
    *,
    respond: Callable[[Float[Array, "7 n"]], Float[Array, " n"]] = step_response,
    confide: Callable[[Float[Array, "7 n"]], Float[Array, " n"]] = step_response,
) -> Bidirectional:
    r"""Diffuses the labels from either side of their edges and compares the depth profiles.

    On the right side of an occlusion edge, a label agrees with its neighbors and a clean step
    remains at the edge; on the wrong side, it contradicts the labels of the other surface.

    Args:
        points: positions, disparities, unit normals.
        gray: center view in [0, 1], `[y, x]`.
        params: see `DirectionalDiffusion`.
        respond: response to the depth profiles at -3..3 px along the normals; the larger one gives
            the side.
        confide: the same for the confidence (Eq. 6.3), px.

    Returns:
        Both maps, responses, confidences. Differentiable at the rasterization chosen.

    Source: Thesis 4.2.2, Eq. 4.8-4.11; 4.3; Eq. 6.3 (as corrected).
    """
    params = cast(params, gray.dtype)
    tx, ty = edge_weights(image_smoothness(gray, params))
    shift = exact_shift(params.offset * points.normal)

    def solve(xy: Array) -> tuple[Array, Array]:
        raster = rasterize(xy, points.disparity, points.valid, (gray.shape[0], gray.shape[1]))
        weight = params.data * raster.hit.astype(gray.dtype)
        dense = diffuse(
            System(weight, raster.values(points.disparity), tx, ty), solver=params.solver
        )
        return dense.value, dense.stats.iterations

    # A loop, so that the program contains the solver once: it compiles slowly.
    both = jnp.stack([points.xy + shift, points.xy - shift])
    (forward, backward), iterations = lax.map(solve, both)

    across = [profiles(image, points.xy, points.normal) for image in (forward, backward)]
    ahead, behind = map(respond, across)
    seen = points.valid & (jnp.sum(points.normal**2, axis=-1) > 0.25)
    return Bidirectional(
        forward,
        backward,
        jnp.where(seen, ahead - behind, 0),
        jnp.where(seen, jnp.maximum(*map(confide, across)), 0),
        depth_edge_confidence(forward, backward),
        iterations,
    )


def depth_edge_confidence(
    forward: Float[Array, "y x"], backward: Float[Array, "y x"]
) -> Float[Array, "y x"]:
    """Gradient magnitude of the mean of both passes, px per px.

    Texture edges are flat in both passes, occlusion edges steep in at least one.

    Args:
        forward: map with labels moved along the normals, `[y, x]`.
        backward: map with labels moved against the normals, `[y, x]`.

    Returns:
        Confidence that a pixel lies on a depth edge, `[y, x]`. Differentiable.

    Source: Thesis 4.3.
    """
    return gradient_magnitude(0.5 * (forward + backward))


def image_smoothness(
    gray: Float[Array, "y x"], params: DirectionalDiffusion
) -> Float[Array, "y x"]:
    """Smoothness of the directional solves, in (0, 1] (Eq. 4.11). Differentiable."""
    params = cast(params, gray.dtype)
    steep = gradient_square(gray)
    if params.form == "inverse":
        steep = safe_sqrt(steep)
    return jnp.maximum(1 / (1 + steep / params.gradient), params.floor)
