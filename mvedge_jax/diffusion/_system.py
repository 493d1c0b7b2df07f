"""The linear system that turns sparse labels into a dense map."""

from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from mvedge_jax._params import accepts_numpy, jax_array

from ._stencil import Coefficients, around, diagonal, differences, energy, product

if TYPE_CHECKING:
    import scipy.sparse


class System(eqx.Module):
    r"""A weighted Poisson problem on the pixel grid.

    Its solution minimizes

    $$\sum_p w_p (D_p - s_p)^2 + \sum_{(p,q)} t_{pq} (D_q - D_p - r_{pq})^2,$$

    which solves $(\mathrm{diag}(w) + L_t) D = w s + \mathrm{div}(t r)$. Without rises $r$ the
    solution is flat away from data; with them it follows a slant. Each edge between 4-neighbors is
    stored once; no edge crosses the border (Neumann).

    Attributes:
        weight: data weights $w \ge 0$; 0 where a pixel has no label. A boolean mask counts as 1
            and 0, in the precision of the labels.
        label: labels $s$, any unit; read only where `weight > 0`.
        tx: weights of the edges between `(y, x)` and `(y, x + 1)`, ≥ 0.
        ty: weights of the edges between `(y, x)` and `(y + 1, x)`, ≥ 0.
        rise_x: preferred `D[y, x + 1] - D[y, x]`, unit of the labels; None for 0.
        rise_y: preferred `D[y + 1, x] - D[y, x]`; None for 0, if `rise_x` is None.

    Source: Thesis 4.2.2 and 6.1, Eq. 4.8, 6.1, 6.2; 7.1.1, Eq. 7.2 (with squares, each edge once).

    Example:
        >>> import jax.numpy as jnp
        >>> weight = jnp.array([[1.0, 0.0, 0.0, 1.0]])
        >>> label = jnp.array([[0.0, 0.0, 0.0, 3.0]])
        >>> system = System(weight, label, jnp.ones((1, 3)), jnp.ones((0, 4)))
        >>> system.matvec(jnp.ones((1, 4))).tolist()
        [[1.0, 0.0, 0.0, 1.0]]
    """

    weight: Float[Array, "y x"] = eqx.field(converter=jax_array)
    label: Float[Array, "y x"] = eqx.field(converter=jax_array)
    tx: Float[Array, "y x-1"] = eqx.field(converter=jax_array)
    ty: Float[Array, "y-1 x"] = eqx.field(converter=jax_array)
    rise_x: Float[Array, "y x-1"] | None = eqx.field(converter=jax_array, default=None)
    rise_y: Float[Array, "y-1 x"] | None = eqx.field(converter=jax_array, default=None)

    def __post_init__(self) -> None:
        if getattr(self.weight, "dtype", None) == jnp.bool_ and hasattr(self.label, "dtype"):
            # JAX's default precision for labels in NumPy, which fields convert after this.
            self.weight = jnp.asarray(self.weight).astype(jnp.asarray(self.label).dtype)

    @property
    def coefficients(self) -> Coefficients:
        """The matrix without the labels."""
        return Coefficients(self.weight, self.tx, self.ty)

    @property
    def edges(self) -> tuple[Array, Array]:
        """`tx` and `ty`."""
        return self.tx, self.ty

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the image."""
        y, x = self.weight.shape[-2:]
        return y, x

    @accepts_numpy
    def matvec(self, value: Float[Array, "y x"]) -> Float[Array, "y x"]:
        """`A D`, computed from differences along edges so that small data weights survive."""
        return product(self.coefficients, value)

    def diagonal(self) -> Float[Array, "y x"]:
        """The diagonal of `A`."""
        return diagonal(self.coefficients)

    def right_hand_side(self) -> Float[Array, "y x"]:
        """`b = w s + div(t r)`; labels of zero weight are ignored, even NaN."""
        counts = (self.weight != 0) | jnp.isfinite(self.label)
        return self.weight * jnp.where(counts, self.label, 0) + inflow(self)

    @accepts_numpy
    def energy(self, value: Float[Array, "y x"]) -> Float[Array, ""]:
        """The quadratic at `value`."""
        label = jnp.where(self.weight > 0, self.label, 0)
        if self.rise_x is None or self.rise_y is None:
            return energy(self.coefficients, label, value)
        along_x, along_y = differences(value)
        return (
            jnp.sum(self.weight * (value - label) ** 2)
            + jnp.sum(self.tx * (along_x - self.rise_x) ** 2)
            + jnp.sum(self.ty * (along_y - self.rise_y) ** 2)
        )

    def to_scipy(self) -> "scipy.sparse.csr_array":
        """The matrix as a float64 SciPy array, rows in the order of `ravel()` (host only)."""
        import scipy.sparse

        y, x = self.shape
        index = np.arange(y * x).reshape(y, x)
        tx, ty = np.asarray(self.tx, np.float64), np.asarray(self.ty, np.float64)
        start = np.concatenate([index[:, :-1].ravel(), index[:-1].ravel()])
        end = np.concatenate([index[:, 1:].ravel(), index[1:].ravel()])
        edge = np.concatenate([tx.ravel(), ty.ravel()])
        diagonal = np.asarray(self.weight, np.float64).ravel()
        diagonal = diagonal + np.bincount(start, edge, y * x) + np.bincount(end, edge, y * x)
        rows = np.concatenate([index.ravel(), start, end])
        columns = np.concatenate([index.ravel(), end, start])
        values = np.concatenate([diagonal, -edge, -edge])
        return scipy.sparse.csr_array((values, (rows, columns)), shape=(y * x, y * x))


def inflow(system: System) -> Array:
    """`div(t r)`: the right-hand side of the rises, with any leading batch axes."""
    if system.rise_x is None or system.rise_y is None:
        return jnp.zeros_like(system.weight)
    return around(system.tx * system.rise_x, system.ty * system.rise_y, -1)


def check(system: System) -> None:
    """Raises a ValueError if a system is invalid; values are checked outside `jit` only."""
    if system.weight.ndim != 2 or 0 in system.weight.shape:
        raise ValueError(
            "`system.weight` must be an image with at least one pixel, [y, x]; "
            f"its shape is {system.weight.shape}. Use `jax.vmap` for batches."
        )
    y, x = system.weight.shape
    wanted = {"label": (y, x), "tx": (y, x - 1), "ty": (y - 1, x)}
    if (system.rise_x is None) != (system.rise_y is None):
        raise ValueError("`system.rise_x` and `system.rise_y` must be given together, or neither.")
    if system.rise_x is not None:
        wanted |= {"rise_x": (y, x - 1), "rise_y": (y - 1, x)}
    for name, shape in wanted.items():
        given = getattr(system, name).shape
        if given != shape:
            raise ValueError(
                f"`system.{name}` has the shape {given}; a `weight` of shape {(y, x)} "
                f"needs {shape}."
            )
    for name in ("weight", *wanted):
        array = getattr(system, name)
        if array.dtype != system.weight.dtype or not jnp.issubdtype(array.dtype, jnp.floating):
            raise TypeError(
                f"`system.{name}` is {array.dtype}; all maps must share one floating type, "
                f"and `weight` is {system.weight.dtype}."
            )
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(system)):
        return
    for name in ("weight", "tx", "ty"):
        array = np.asarray(getattr(system, name))
        if not array.size:
            continue
        lowest, highest = float(array.min()), float(array.max())
        if not (lowest >= 0 and np.isfinite(highest)):
            raise ValueError(
                f"`system.{name}` must be finite and not negative; it has values from "
                f"{lowest} to {highest} (NaN counts as both)."
            )
    weight = np.asarray(system.weight)
    labels = np.asarray(system.label)
    if not np.isfinite(labels).all():
        bad = int((~np.isfinite(labels) & (weight > 0)).sum())
        if bad:
            raise ValueError(
                f"`system.label` is NaN or infinite at {bad} pixels whose data weight is "
                "positive; set their weight to 0 or give them a label."
            )
