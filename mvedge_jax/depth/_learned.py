"""Dense labels whose weights a small network corrects."""

from functools import cache
from importlib.resources import files
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from mvedge_jax.image import convolution
from mvedge_jax.photometry.measuring import PhotometricLabels

from ._dense import LabelContext, MeasuredLabels
from ._labels import Labels

# Planes of `_seen`.
_INPUTS = 15
_LEARNED = "learned.npz"  # written by `experiments/learned_preset.py`
_NETWORK = "dense.network"


class ConfidenceNetwork(eqx.Module):
    """Convolutions at full, half and a quarter of the resolution: some 70 px of surroundings.

    Attributes:
        halved: to half the resolution.
        quartered: to a quarter.
        deep: residual convolutions there, each with a wider dilation.
        joined: of both, at half the resolution.
        mixed: of that and of the inputs, at full resolution.
        last: to one number per pixel; 0 at first.
    """

    halved: eqx.nn.Conv2d
    quartered: eqx.nn.Conv2d
    deep: list[eqx.nn.Conv2d]
    joined: eqx.nn.Conv2d
    mixed: eqx.nn.Conv2d
    last: eqx.nn.Conv2d

    def __init__(self, *, key: PRNGKeyArray):
        half, quarter, full = 16, 24, 12
        keys = iter(jax.random.split(key, 7))

        def layer(before: int, after: int, side: int = 3, **options: Any) -> eqx.nn.Conv2d:
            padding = options.get("dilation", 1) * (side // 2)
            return eqx.nn.Conv2d(before, after, side, padding=padding, key=next(keys), **options)

        self.halved = layer(_INPUTS, half, stride=2)
        self.quartered = layer(half, quarter, stride=2)
        self.deep = [layer(quarter, quarter, dilation=d) for d in (2, 4)]
        self.joined = layer(half + quarter, half)
        self.mixed = layer(half + _INPUTS, full)
        # The rule, until something is learned.
        self.last = jax.tree.map(jnp.zeros_like, layer(full, 1, side=1))

    def __call__(self, seen: Float[Array, "k y x"]) -> Float[Array, "y x"]:
        """One number per pixel; sides need not be multiples of 4."""
        height, width = seen.shape[1:]
        seen = jnp.pad(seen, ((0, 0), (0, -height % 4), (0, -width % 4)), mode="edge")
        half = jax.nn.relu(convolution(self.halved, seen))
        quarter = jax.nn.relu(convolution(self.quartered, half))
        for layer in self.deep:
            quarter = quarter + jax.nn.relu(convolution(layer, quarter))
        half = jnp.concatenate([half, _doubled(quarter)])
        half = jax.nn.relu(convolution(self.joined, half))
        full = jnp.concatenate([seen, _doubled(half)])
        full = jax.nn.relu(convolution(self.mixed, full))
        return convolution(self.last, full)[0, :height, :width]


class LearnedLabels(MeasuredLabels):
    """`MeasuredLabels` with the odds of their weights multiplied by a network's factor.

    The standard error of a label knows the views, not the picture: it can't tell a label of a plain
    wall that follows noise from one of fine texture. The network sees the labels, the map and the
    colors around a pixel, all in units of the standard error or of the noise.

    Attributes:
        network: what the log odds of a weight are lowered by.
    """

    network: ConfidenceNetwork = eqx.field(kw_only=True)

    @staticmethod
    def untrained(*, key: PRNGKeyArray) -> "LearnedLabels":
        """Labels with a network that changes nothing yet.

        Args:
            key: of all weights but the last ones, which are 0.

        Returns:
            The part, to be learned.
        """
        return LearnedLabels(network=ConfidenceNetwork(key=key))

    def weight(
        self,
        from_points: Labels,
        measured: PhotometricLabels,
        disparity: Float[Array, "y x"],
        context: LabelContext,
    ) -> Float[Array, "y x"]:
        """See `MeasuredLabels`."""
        known = super().weight(from_points, measured, disparity, context)
        seen = _seen(known, from_points, measured, disparity, context)
        return jax.nn.sigmoid(_log_odds(known) - self.network(seen))


def learned_labels() -> LearnedLabels:
    """Labels with the weights that come with the package."""
    network = eqx.filter_eval_shape(ConfidenceNetwork, key=jax.random.key(0))
    known = learned_values()

    def stored(path: Any, _: Any) -> Array:
        return jnp.asarray(known[_NETWORK + jax.tree_util.keystr(path)])

    return LearnedLabels(network=jax.tree_util.tree_map_with_path(stored, network))


def learned_numbers() -> dict[str, np.ndarray]:
    """Numbers of a model for 9x9 views that were learned together with the network, by path."""
    known = learned_values()
    return {path: value for path, value in known.items() if not path.startswith(_NETWORK)}


@cache
def learned_values() -> dict[str, np.ndarray]:
    """All that was learned, by the paths of a model; docs/learned.md has the scores."""
    with (files("mvedge_jax.depth") / _LEARNED).open("rb") as file, np.load(file) as stored:
        return {path: stored[path].astype(np.float32) for path in stored.files}


def _seen(
    weight: Float[Array, "y x"],
    from_points: Labels,
    measured: PhotometricLabels,
    disparity: Float[Array, "y x"],
    context: LabelContext,
) -> Float[Array, "k y x"]:
    """What the network sees: planes of about unit size, free of the views' step and noise."""
    square, noise = context.precision**2, context.measuring.noise

    def soft(difference: Array) -> Array:
        return jnp.arcsinh(difference / (4 * context.precision)) / 3

    colors = [jnp.sum(step**2, axis=0) for step in _steps(context.lab)]
    around = measured.variance
    if context.hypotheses is not None:
        around = context.hypotheses.variance_around(disparity)
    planes = [
        jnp.log(measured.variance / square) / 4,
        jnp.log1p(measured.residual / noise**2) / 2,
        soft(measured.disparity - disparity),
        _log_odds(weight) / 4,
        from_points.weight,
        jnp.where(from_points.weight > 0, soft(from_points.value - disparity), 0),
        jnp.log(around / square + 1e-2) / 6,
        *(soft(step) for step in _steps(disparity)),
        *(soft(step) for step in _steps(measured.disparity)),
        *(jnp.log(color + 1e-2) / 4 for color in colors),
        context.lab[0] / 50 - 1,
        jnp.broadcast_to(jnp.log(255 * noise) / 2, disparity.shape),
    ]
    return jnp.stack(planes)


def _steps(values: Float[Array, "*c y x"]) -> tuple[Array, Array]:
    """Differences to the right and downwards, 0 at the border."""
    right = jnp.diff(values, axis=-1, append=values[..., -1:])
    return right, jnp.diff(values, axis=-2, append=values[..., -1:, :])


def _log_odds(weight: Array) -> Array:
    weight = jnp.clip(weight, 1e-5, 1 - 1e-4)
    return jnp.log(weight / (1 - weight))


def _doubled(planes: Float[Array, "k y x"]) -> Float[Array, "k Y X"]:
    """Every pixel as 2x2."""
    return jnp.repeat(jnp.repeat(planes, 2, axis=1), 2, axis=2)
