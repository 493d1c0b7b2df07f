"""Derivatives of a scalar of a pytree, leaf by leaf, beside central differences."""

import contextlib
from collections.abc import Callable, Iterator, Set
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from helpers import dot, lean, random_like

from mvedge_jax.datasets import synthetic
from mvedge_jax.lightfield import LightField

# The smallest one comes last: one-sided differences tell a kink there.
LADDER = (1e-5, 1e-6, 3e-5, 1e-7, 1e-4, 1e-3, 3e-8, 1e-8)
# Relative difference of two steps of the ladder that makes a plateau.
AGREE = 3e-4


class Row(NamedTuple):
    """Derivatives along one direction, of a leaf or a random one of the views.

    Attributes:
        name: the leaf's path.
        reverse: derivative by `jax.grad`.
        forward: by `jax.jvp`.
        numeric: by central differences, the mean of the first two steps of the ladder that agree.
        sides: the one-sided differences at the last step that was tried.
        least: slopes below this are lost in the rounding of the differences.
    """

    name: str
    reverse: float
    forward: float
    numeric: float
    sides: tuple[float, float]
    least: float

    @property
    def error(self) -> float:
        """Of either mode, relative to the slope or to `least`; infinite if one is no number."""
        size = max(abs(self.numeric), abs(self.reverse), abs(self.forward), self.least)
        worst = max(abs(self.reverse - self.numeric), abs(self.forward - self.numeric)) / size
        return worst if np.isfinite(worst) else np.inf

    @property
    def kink(self) -> bool:
        """One-sided differences differ, and both modes agree on a slope from one to the other."""
        low, high = sorted(self.sides)
        most = max(abs(low), abs(high), 1e-300)
        agree = abs(self.reverse - self.forward) <= 1e-9 * abs(self.reverse)
        between = low - 1e-3 * most <= self.reverse <= high + 1e-3 * most
        return high - low > 1e-2 * most and agree and between

    @property
    def zero(self) -> bool:
        """Neither mode sees an influence."""
        return self.reverse == 0 and self.forward == 0


def rows(loss: Callable[[Any], Any], tree: Any, views: Any, *, directions: int) -> list[Row]:
    """Compares every leaf of `tree` and random directions of `views`, all in float64.

    Args:
        loss: of `(tree, views)`.
        tree: parameters.
        views: array.
        directions: random directions of the views.

    Returns:
        A row per leaf, by path, and one per direction of the views.
    """
    moving, rest = eqx.partition(tree, eqx.is_inexact_array)
    key = jax.random.key(1)

    def of(m: Any, x: Any) -> Any:
        return loss((eqx.combine(m, rest), x))

    with _optimized(False):  # runs once
        here, gradient = lean(jax.value_and_grad(of, (0, 1)))(moving, views)
    with _optimized(True):  # run hundreds of times
        value = lean(of).lower(moving, views).compile()
        push = lean(lambda m, x, dm, dx: jax.jvp(of, (m, x), (dm, dx))[1])
        push = push.lower(moving, views, moving, views).compile()
    center = float(value(moving, views))
    # Rounding decides a tie, and this program rounds otherwise.
    assert np.isclose(float(here), center, rtol=1e-7), "a tie: modes select different points"

    def compare(name: str, direction: Any, size: float) -> Row:
        reverse, forward = dot(gradient, direction), float(push(moving, views, *direction))

        def at(t: float) -> float:
            return float(value(*jax.tree.map(lambda a, b: a + t * b, (moving, views), direction)))

        slopes, sides, least = [], (0.0, 0.0), 1e-6 * abs(center) / size
        if reverse == forward == 0:  # constant around here, though perhaps not far from here
            for step in (1e-5, 1e-7, 1e-9):
                if at(step * size) == at(-step * size) == center:
                    return Row(name, reverse, forward, 0.0, sides, least)
        for step in size * np.array(LADDER):
            above, below = at(step), at(-step)
            slope, sides = (
                (above - below) / (2 * step),
                ((above - center) / step, (center - below) / step),
            )
            for other in slopes:
                if abs(slope - other) < AGREE * max(abs(slope), abs(other), least):
                    return Row(name, reverse, forward, 0.5 * (slope + other), sides, least)
            slopes.append(slope)
        return Row(name, reverse, forward, float(np.median(slopes)), sides, least)

    found, nothing = [], jax.tree.map(jnp.zeros_like, moving)
    leaves, structure = jax.tree_util.tree_flatten_with_path(moving)
    for index, (path, leaf) in enumerate(leaves):
        flat = [jnp.zeros_like(a) for _, a in leaves]
        draw = random_like(leaf, key=jax.random.fold_in(key, index))
        flat[index] = draw if leaf.ndim else jnp.ones_like(leaf)
        direction = structure.unflatten(flat), jnp.zeros_like(views)
        name = jax.tree_util.keystr(path).lstrip(".")
        found.append(compare(name, direction, float(jnp.abs(leaf).max()) or 1e-2))
    for k in range(directions):
        draw = jax.random.normal(jax.random.fold_in(key, 1000 + k), views.shape, views.dtype)
        found.append(compare(f"views, direction {k}", (nothing, draw), 1e-2))
    return found


@contextlib.contextmanager
def _optimized(wish: bool) -> Iterator[None]:
    """Whether XLA optimizes what is compiled meanwhile."""
    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", not wish)
    try:
        yield
    finally:
        jax.config.update("jax_disable_most_optimizations", before)


def check_rows(found: list[Row], zero: Set[str], *, sometimes: Set[str] = frozenset()) -> None:
    """Right to 1e-3 in both modes, or exactly zero and known to be; a kink is told from an error.

    Of `zero`, the derivative is always 0, of `sometimes`, in some scenes. At a kink the derivative
    may be that of either side, or lie between them; only views may be at one.
    """
    report = "\n".join(
        f"{r.name:28s} reverse {r.reverse:+.6e}  forward {r.forward:+.6e}  "
        f"differences {r.numeric:+.6e}  error {r.error:.1e}  sides {r.sides}"
        for r in found
    )
    print(report)  # noqa: T201 (`pytest -s` shows the table)
    wrong = [r for r in found if r.error > 1e-3]
    bad = [r.name for r in wrong if not (r.kink and r.name.startswith("views"))]
    assert not bad, f"{bad}\n{report}"
    still = {r.name for r in found if r.zero}
    assert zero <= still <= zero | sometimes, f"{still ^ zero}\n{report}"


def noisy_scene(name: str, size: int, *, dtype: type = np.float64) -> LightField:
    """A small rendered scene without its truth.

    A quarter of a gray level of noise: in a clean image both pixels beside an edge have the very
    same contrast, and any change of the views, however small, chooses another one.
    """
    light_field = synthetic.render(
        synthetic.scene(name), shape=(5, 5, size, size), samples=2, key=jax.random.key(0)
    )
    blind = light_field.without_truth()
    views = blind.views.astype(dtype)
    views = views + 1e-3 * jax.random.normal(jax.random.key(4), views.shape, dtype)
    return eqx.tree_at(lambda f: f.views, blind, views)
