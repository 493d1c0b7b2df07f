"""Derivatives of a scalar of a pytree, leaf by leaf, beside central differences."""

import contextlib
from collections.abc import Callable, Iterator, Set
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from helpers import dot, lean, random_like
from jaxtyping import PRNGKeyArray

from mvedge_jax.datasets import synthetic
from mvedge_jax.lightfield import LightField


class Row(NamedTuple):
    """One direction: of a leaf, or a random one of the views.

    Attributes:
        name: the leaf's path.
        reverse: derivative by `jax.grad`.
        forward: by `jax.jvp`.
        numeric: by central differences, the mean of the first two steps of the ladder that agree.
        spread: difference of those two, relative to the slope or to `least`.
        sides: the one-sided differences at the last step that was tried.
        least: slopes below this are lost in the rounding of the differences.
    """

    name: str
    reverse: float
    forward: float
    numeric: float
    spread: float
    sides: tuple[float, float]
    least: float

    @property
    def error(self) -> float:
        """Of either mode, relative to the slope or to `least`; infinite if one is no number."""
        size = max(abs(self.numeric), abs(self.reverse), abs(self.forward), self.least)
        worst = max(abs(self.reverse - self.numeric), abs(self.forward - self.numeric)) / size
        return worst if np.isfinite(worst) else np.inf

    @property
    def kink(self) -> float:
        """Relative difference of the one-sided differences."""
        return abs(self.sides[0] - self.sides[1]) / max(*map(abs, self.sides), 1e-300)

    @property
    def between(self) -> bool:
        """Both modes agree on a slope from one side's to the other's."""
        low, high = min(self.sides), max(self.sides)
        room = 1e-3 * max(abs(low), abs(high))
        agree = abs(self.reverse - self.forward) <= 1e-9 * abs(self.reverse)
        return agree and low - room <= self.reverse <= high + room

    @property
    def zero(self) -> bool:
        """Neither mode sees an influence."""
        return self.reverse == 0 and self.forward == 0


# The smallest one comes last: one-sided differences tell a kink there.
LADDER = (1e-5, 1e-6, 3e-5, 1e-7, 1e-4, 1e-3, 1e-8)


def rows(
    loss: Callable[[Any], Any],
    tree: Any,
    views: Any,
    *,
    agree: float,
    directions: int,
    key: PRNGKeyArray,
) -> list[Row]:
    """Compares every leaf of `tree` and random directions of `views`.

    Args:
        loss: of `(tree, views)`.
        tree: parameters, float64.
        views: array, float64.
        agree: relative difference of two steps of the ladder that makes a plateau.
        directions: random directions of the views.
        key: draws them.

    Returns:
        A row per leaf, by path, and one per direction of the views.
    """
    moving, rest = eqx.partition(tree, eqx.is_inexact_array)

    def of(m: Any, x: Any) -> Any:
        return loss((eqx.combine(m, rest), x))

    with _optimised(False):  # runs once
        here, gradient = lean(jax.value_and_grad(of, (0, 1)))(moving, views)
    with _optimised(True):  # run hundreds of times
        value = lean(of).lower(moving, views).compile()
        push = lean(lambda m, x, dm, dx: jax.jvp(of, (m, x), (dm, dx))[1])
        push = push.lower(moving, views, moving, views).compile()
    still, nothing = jnp.zeros_like(views), jax.tree.map(jnp.zeros_like, moving)
    leaves, structure = jax.tree_util.tree_flatten_with_path(moving)
    centre = float(value(moving, views))
    # Rounding decides a tie, and this program rounds otherwise.
    assert np.isclose(float(here), centre, rtol=1e-7), "a tie: modes select different points"
    found = []

    def compare(name: str, direction: Any, size: float) -> Row:
        reverse = dot(gradient, direction)
        forward = float(push(moving, views, *direction))

        def at(t: float) -> float:
            return float(value(*jax.tree.map(lambda a, b: a + t * b, (moving, views), direction)))

        slopes, sides, least = [], (0.0, 0.0), 1e-6 * abs(centre) / size
        if reverse == forward == 0:  # constant around here, though perhaps not far from here
            for step in (1e-5, 1e-7, 1e-9):
                if at(step * size) == at(-step * size) == centre:
                    return Row(name, reverse, forward, 0.0, 0.0, sides, least)
        for relative in LADDER:
            step = relative * size
            above, below = at(step), at(-step)
            slope = (above - below) / (2 * step)
            sides = ((above - centre) / step, (centre - below) / step)
            for other in slopes:
                spread = abs(slope - other) / max(abs(slope), abs(other), least)
                if spread < agree:
                    return Row(name, reverse, forward, 0.5 * (slope + other), spread, sides, least)
            slopes.append(slope)
        return Row(name, reverse, forward, float(np.median(slopes)), np.inf, sides, least)

    for index, (path, leaf) in enumerate(leaves):
        if leaf.ndim:
            unit = random_like(leaf, key=jax.random.fold_in(key, index))
        else:
            unit = jnp.ones_like(leaf)
        flat = [unit if i == index else jnp.zeros_like(a) for i, (_, a) in enumerate(leaves)]
        name = jax.tree_util.keystr(path).lstrip(".")
        size = float(jnp.abs(leaf).max()) or 1e-2
        found.append(compare(name, (structure.unflatten(flat), still), size))
    for k in range(directions):
        direction = jax.random.normal(jax.random.fold_in(key, 1000 + k), views.shape, views.dtype)
        found.append(compare(f"views, direction {k}", (nothing, direction), 1e-2))
    return found


@contextlib.contextmanager
def _optimised(wish: bool) -> Iterator[None]:
    """Whether XLA optimises what is compiled meanwhile."""
    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", not wish)
    try:
        yield
    finally:
        jax.config.update("jax_disable_most_optimizations", before)


def table(found: list[Row]) -> str:
    """The rows as text, for the closing note and failures."""
    lines = [
        f"{r.name:28s} reverse {r.reverse:+.6e}  forward {r.forward:+.6e}  "
        f"differences {r.numeric:+.6e}  error {r.error:.1e}  plateau {r.spread:.0e}  "
        f"kink {r.kink:.0e}"
        for r in found
    ]
    return "\n".join(lines)


def check_rows(
    loss: Callable[[Any], Any],
    tree: Any,
    views: Any,
    zero: Set[str],
    *,
    directions: int,
    sometimes: Set[str] = frozenset(),
):
    """Right to 1e-3 in both modes, or exactly zero and known to be; a kink is told from an error.

    Of `zero`, the derivative is always 0, of `sometimes`, in some scenes. At a kink the derivative
    may be that of either side, or lie between them.
    """
    found = rows(loss, tree, views, agree=3e-4, directions=directions, key=jax.random.key(1))
    report = table(found)
    print(report)  # noqa: T201 (`pytest -s` shows the table)
    wrong = [r.name for r in found if r.error > 1e-3 and not (r.kink > 1e-2 and r.between)]
    assert not wrong, f"{wrong}\n{report}"
    kinks = [r.name for r in found if r.error > 1e-3]
    assert all(k.startswith("views") for k in kinks), f"{kinks}\n{report}"
    still = {r.name for r in found if r.zero}
    assert zero <= still <= zero | sometimes, f"{still ^ zero}\n{report}"


def noisy_scene(name: str, size: int, *, dtype: type = np.float64) -> LightField:
    """A small rendered scene without its truth.

    A quarter of a grey level of noise: in a clean image both pixels beside an edge have the very
    same contrast, and any change of the views, however small, chooses another one.
    """
    light_field = synthetic.render(
        synthetic.scene(name), shape=(5, 5, size, size), samples=2, key=jax.random.key(0)
    )
    blind = light_field.without_truth()
    views = blind.views.astype(dtype)
    views = views + 1e-3 * jax.random.normal(jax.random.key(4), views.shape, dtype)
    return eqx.tree_at(lambda f: f.views, blind, views)
