"""Standard error of a map: of its labels, of regions without any, and of depth steps."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._params import cast, number
from mvedge_jax._root import safe_sqrt


class StandardError(eqx.Module):
    r"""From standard errors of labels to those of the map.

    The error $\sigma$ of a label becomes $m \sigma^2 / (\sigma + h)$: the map averages labels that
    agree, so most pixels are far more accurate than the floor of their labels' errors, whereas
    inaccurate labels share their error with all labels around. A bend of the map adds an error,
    because windows of labels average over it.

    Only the stated error depends on these numbers, never the map. Defaults are from cotton,
    backgammon, bench
    and rendered scenes, see `experiments/calibration.py`.

    Attributes:
        most: $m$, error of the map per error of inaccurate labels.
        half: $h$, error of a label at which this ratio is halved. For 9x9 views; larger for fewer.
        bent: error of the map per second difference between neighbors.
        step: second differences beyond this are depth steps, which are errors of another kind. For
            9x9 views; larger for fewer.
        misplaced: uncertainty of the position of a depth step.
        alike: the spread of the map is used as far as there are more perfect labels than this
            number, that of a window of 7x7 pixels. With fewer labels, the width of the searched
            range is used.
        forgotten: distance from any label beyond which the error is the spread of the map.
        rival: spread of the posterior over hypotheses up to which a pixel has no rivals. For 9x9
            views; larger for fewer.
    """

    most: Float[Array, ""] = number(2.5)
    half: Float[Array, ""] = number(0.045, "px")
    bent: Float[Array, ""] = number(4.5)
    step: Float[Array, ""] = number(0.1, "px")
    misplaced: Float[Array, ""] = number(0.5, "px")
    alike: Float[Array, ""] = number(49.0, "perfect labels")
    forgotten: Float[Array, ""] = number(55.0, "px")
    rival: Float[Array, ""] = number(0.125, "px")

    def __call__(
        self,
        of_labels: Float[Array, "y x"],
        disparity: Float[Array, "y x"],
        around: Float[Array, "y x"] | None = None,
    ) -> Float[Array, "y x"]:
        """Standard error of a map.

        Args:
            of_labels: standard error of the labels that a pixel is made from, px; 0 without labels.
            disparity: the map, px.
            around: second moment around the map of the posterior over hypotheses, px²: the labels'
                own errors do not contain rival hypotheses. None without hypotheses.

        Returns:
            px; infinite without labels. Differentiable.
        """
        params = cast(self, disparity.dtype)
        known = of_labels > 0
        labels = jnp.where(known, of_labels, 1)
        labels = params.most * labels * (labels / (labels + params.half))
        bend = sharpest(disparity)
        bent = params.bent * bend / (1 + bend / params.step)
        square = labels**2 + bent**2 + (params.misplaced * bend) ** 2
        if around is not None:
            square = square + params.rivals(around)
        return jnp.where(known, jnp.sqrt(square), jnp.inf)

    def rivals(self, around: Float[Array, "y x"]) -> Float[Array, "y x"]:
        """Variance by rival hypotheses, px².

        Args:
            around: second moment of the posterior over hypotheses around a map, px².

        Returns:
            px²; 0 where the posterior is as narrow as one hypothesis. Differentiable.
        """
        return jnp.maximum(safe_sqrt(around) - self.rival, 0) ** 2

    def spread(self, disparity: Array, weight: Array, span: Array) -> Array:
        """Standard error of a surface without labels: spread of the map, or width of the range.

        Args:
            disparity: the map, any shape.
            weight: weights of the labels, 1/variance relative to a perfect one, broadcastable.
            span: width of the range that was searched.

        Returns:
            A standard error, one number. Differentiable.
        """
        evidence = jnp.sum(weight)
        variance = evidence * jnp.var(disparity) + self.alike * span**2
        return safe_sqrt(variance / (evidence + self.alike))


def steepest(disparity: Array) -> Array:
    """Largest difference from a direct neighbor.

    Args:
        disparity: a map, [y, x].

    Returns:
        Of its shape. Differentiable.
    """
    across, down = jnp.abs(jnp.diff(disparity, axis=1)), jnp.abs(jnp.diff(disparity, axis=0))
    most = jnp.zeros_like(disparity)
    for side in ((0, 1), (1, 0)):
        most = jnp.maximum(most, jnp.pad(across, ((0, 0), side)))
        most = jnp.maximum(most, jnp.pad(down, (side, (0, 0))))
    return most


def sharpest(disparity: Array) -> Array:
    """Largest second difference along either axis; the border is no bend.

    Args:
        disparity: a map, [y, x].

    Returns:
        Of its shape, 0 on planes. Differentiable.
    """
    most = jnp.zeros_like(disparity)
    for axis, margin in ((1, ((0, 0), (1, 1))), (0, ((1, 1), (0, 0)))):
        if disparity.shape[axis] > 2:
            second = jnp.abs(jnp.diff(disparity, n=2, axis=axis))
            most = jnp.maximum(most, jnp.pad(second, margin))
    return most
