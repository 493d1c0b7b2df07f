"""The result of the chain."""

from typing import NamedTuple

from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._params import readable
from mvedge_jax.edges import EdgePoints, EdgeStats
from mvedge_jax.edges.sides import SurfaceVectors
from mvedge_jax.photometry import Noise
from mvedge_jax.photometry.brightness import Exposure

from ._problems import problems


class DepthStats(NamedTuple):
    """Statistics of the chain.

    Attributes:
        edges: counts of the point stage.
        points: edge points that reached a pixel.
        sided: points with a surface vector.
        iterations: solver iterations of the two directional diffusions and of every map, in order.
        converged: whether every diffusion of maps, slopes and errors reached its tolerance.
        noise: noise of the views, in their units after `exposure` was removed.
        exposure: `gain` and `vignette` that were removed from the views before they were compared.
        sound: whether all parameters were finite and none negative; if not, the map is NaN.
        searched: lowest and highest disparity searched, px per view step.
    """

    edges: EdgeStats
    points: Int[Array, ""]
    sided: Int[Array, ""]
    iterations: Int[Array, " solves"]
    converged: Bool[Array, ""]
    noise: Noise
    exposure: Exposure
    sound: Bool[Array, ""]
    searched: Float[Array, "2"]

    def __repr__(self) -> str:
        return readable(self)


class DepthResult(NamedTuple):
    """Depth of the center view, with the edges and statistics behind it.

    Attributes:
        disparity: px per view step, larger is nearer, `[y, x]`.
        error: standard error of the disparity, px, `[y, x]`. It combines the errors of the labels
            that a pixel was diffused from, the bending of the map, and half a pixel of uncertainty
            about the position of a depth step. Far from any label it grows to the spread of the
            map or, if little was measured, to the width of the searched range. Infinite if there
            is no label at all.
        depth_edge: depth-edge confidence, px per px, `[y, x]`: the gradient of the map or, where
            the chain has no dense labels, that of its `sides` (Thesis, Section 4.3).
        points: the multi-view edges.
        surface: their surface vectors, scores and probabilities.
        stats: counts and iterations.
    """

    disparity: Float[Array, "y x"]
    error: Float[Array, "y x"]
    depth_edge: Float[Array, "y x"]
    points: EdgePoints
    surface: SurfaceVectors
    stats: DepthStats

    def problems(self) -> tuple[str, ...]:
        """Problems of the map by its statistics, one sentence each; on the host."""
        return problems(self)

    def check(self) -> "DepthResult":
        """The same result, if it has no problems; on the host.

        Raises:
            RuntimeError: with the sentences of `problems`.
        """
        found = self.problems()
        if found:
            raise RuntimeError("The depth is not to be trusted: " + " ".join(found))
        return self
