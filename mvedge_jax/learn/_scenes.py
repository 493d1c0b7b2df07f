"""Scenes that one program serves, the batches of a step, and the program."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from mvedge_jax._batched import batched
from mvedge_jax._compiler import lean_jit
from mvedge_jax.edges import scene_range
from mvedge_jax.lightfield import LightField

from ._choice import Choice, Values
from ._loss import Loss


def of_one_range(light_fields: Sequence[LightField]) -> list[LightField]:
    """Light fields with the widest of their ranges, so that one model serves them all.

    Args:
        light_fields: ranges that are not known are measured.

    Returns:
        The same views and truths, with one disparity range.

    Raises:
        ValueError: there are none, or a range can't be measured.
    """
    if not light_fields:
        raise ValueError("`light_fields` must have one at least, got none.")
    lows, highs = zip(*(scene_range(field) for field in light_fields), strict=True)
    widest = (min(lows), max(highs))
    return [_without_camera(field.with_range(*widest)) for field in light_fields]


def _without_camera(field: LightField) -> LightField:
    """Scenes are stacked, of which one may have a camera and another none."""
    return eqx.tree_at(lambda f: f.camera, field, None, is_leaf=lambda leaf: leaf is None)


class Scenes:
    """Scenes of one kind, light fields of equal shapes, read one by one and stacked."""

    def __init__(self, name: str, fields: Sequence[LightField], like: LightField | None = None):
        if len(fields) == 0:
            raise ValueError(f"`{name}` must have one scene at least, got none.")
        self.fields, self._name, self._like = fields, name, like

    def __len__(self) -> int:
        return len(self.fields)

    def like(self) -> LightField:
        """A scene that all others have to be like."""
        return _plain(self.fields[0]) if self._like is None else self._like

    def stack(self, places: Sequence[int]) -> LightField:
        """Some scenes, stacked on a leading axis of every leaf."""
        like, found = self.like(), []
        for place in places:
            field = self.fields[place]
            plain = _plain(field)
            if _kind(plain) != _kind(like):
                raise ValueError(
                    f"`{self._name}[{place}]` ({field.name}) must be like the first scene, so that "
                    f"one program serves all: it has views {plain.views.shape} "
                    f"{plain.views.dtype}, not {like.views.shape} {like.views.dtype}, or another "
                    "of the two has a truth, or positions, or more of a truth."
                )
            found.append(plain)
        return jax.tree.map(lambda *leaves: jnp.stack(leaves), *found)

    def drawn(self, step: int, count: int, seed: Sequence[int]) -> list[int]:
        """Places of the scenes of a step, from 0 on: all in a random order, then in another one."""
        found = []
        for number in range(step * count, (step + 1) * count):
            turn, place = divmod(number, len(self))
            order = np.random.default_rng([*seed, turn]).permutation(len(self))
            found.append(int(order[place]))
        return found

    def check_covered(self, model: Any) -> None:
        """Refuses scenes beyond the range that a model searches; not those yet to be rendered."""
        searched = getattr(model, "searched", None)
        known = self.fields[0].disparity_range
        if searched is None or known is None:
            return
        low, high = map(float, np.asarray(known))
        # Ranges of files are rounded.
        if low < searched[0] - 0.02 or high > searched[1] + 0.02:
            raise ValueError(
                f"`model` searches disparities from {searched[0]:.4g} to {searched[1]:.4g}, but "
                f"`{self._name}[0]` says {low:.4g} to {high:.4g} px; `of_one_range` gives scenes "
                "one range, for which `EdgeDepth.for_light_field` makes a model."
            )


def _plain(field: LightField) -> LightField:
    """A scene without what tells it from others of its kind, but for its views and its truth."""
    bare = field.bare()
    return eqx.tree_at(lambda s: s.truth, bare, field.truth, is_leaf=lambda leaf: leaf is None)


def _kind(field: LightField) -> Any:
    shapes = tuple((leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(field))
    return jax.tree.structure(field), shapes


def _loss(
    field: LightField, values: Values, model: Any, key: PRNGKeyArray, choice: Choice, loss: Loss
) -> Float[Array, ""]:
    return loss(choice.into(model, values)(field.without_truth(), key=key), field)


@lean_jit
def losses(
    fields: LightField, values: Values, model: Any, key: PRNGKeyArray, choice: Choice, loss: Loss
) -> Float[Array, " b"]:
    """The loss of every one of stacked scenes."""

    def one(field: LightField, values: Values, model: Any) -> Array:
        return _loss(field, values, model, key, choice, loss)

    return batched(one)(fields, values, model)


@lean_jit
def losses_and_slope(
    fields: LightField,
    values: Values,
    model: Any,
    key: PRNGKeyArray,
    limit: Float[Array, ""],
    choice: Choice,
    loss: Loss,
) -> tuple[Float[Array, " b"], Values]:
    """The loss of every one of stacked scenes, and the mean of their gradients.

    A scene's gradient is shortened to a norm of `limit`: no scene rules a step.
    """

    def one(field: LightField, values: Values, model: Any) -> tuple[Array, Values]:
        def of(values: Values) -> Array:
            return _loss(field, values, model, key, choice, loss)

        value, slope = jax.value_and_grad(of)(values)
        squares = [jnp.sum(leaf * leaf).astype(limit.dtype) for leaf in slope.values()]
        norm = jnp.sqrt(jnp.stack(squares).sum())
        # A number without a derivative is told by its path: it must not spread to the others.
        share = jnp.where(
            jnp.isfinite(norm), jnp.minimum(limit / jnp.maximum(norm, 1e-30), 1.0), 1.0
        )
        return value, {path: share.astype(leaf.dtype) * leaf for path, leaf in slope.items()}

    found, slopes = batched(one)(fields, values, model)
    return found, jax.tree.map(lambda leaf: leaf.mean(0), slopes)
